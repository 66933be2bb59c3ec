"""Where the rocks of one eye lie in the elevations of another.

From far a camera's rocks are all off by one and the same: a mrad of its direction is 1.5 m of
ground from 1500 m. Each of them is known no better than that, though they lie within decimetres of
their places among each other. So the one shift is sought at which rises are where the rocks are. A
rock that so many samples have met shows a rise of half its height with a probability h; by chance
one lies there with that of any place, f. A rock with a rise speaks for a shift by
``log((h + (1 - h) f) / f)``, one without against it by ``log(1 - h)``. With the shift's own spread
that gives its mean and its covariance: where the elevations tell nothing, both are what they were.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.fusion.heights import INDEPENDENT, LEAST_RADIUS
from lunarsim.onboard.hazards.published import RockTracks

Array = NDArray[np.float64]

# Rocks are compared with the highest rise so near, m, of half their height or more; a half
# ellipsoid is that high over three quarters of its area.
_NEAR, _SHOWS, _TOP = 0.35, 0.5, 0.75
# So many rocks are where they seem to be.
_TRUE = 0.8
# Shifts are tried to so many deviations, but not beyond, m.
_DEVIATIONS, _FARTHEST = 3.0, 4.0
# A shift is no better known than that, nor is a rock among the others, m.
_LEAST, _APART = 0.1, 0.15
# Fewer rocks tell no shift.
_FEWEST = 3
_RAREST = 1e-3


@dataclass(frozen=True)
class Shift:
    """By how much rocks are to be moved.

    Attributes
    ----------
    by
        East and north (2,), m.
    sigma
        How well it is known, an axis, m.
    common
        How well it was known before, m.
    """

    by: Array
    sigma: float
    common: float


def registered(
    tracks: RockTracks,
    rises: NDArray[np.float32],
    density: Array,
    grid: Grid,
    scale: float,
    height_ratio: float,
) -> RockTracks:
    """Return rocks where the elevations have them; with too few as they were.

    Parameters
    ----------
    tracks
        The rocks.
    rises
        How far the samples of each cell stand above the ground about them (rows, cols), m; NaN
        where there are none.
    density
        Samples on a square metre (rows, cols).
    grid
        Cells of both.
    scale
        Height of the rocks over their radius.
    height_ratio
        Height over diameter of the rocks that the mission expects.
    """
    shift = shift_of(tracks, rises, density, grid, scale, height_ratio)
    if shift is None:
        return tracks
    own = np.sqrt(np.maximum(tracks.sigma**2 - shift.common**2, 0.0) + _APART**2)
    sigma = np.minimum(np.hypot(own, shift.sigma), np.maximum(tracks.sigma, _APART))
    return replace(tracks, xy=tracks.xy + shift.by, sigma=sigma)


def shift_of(
    tracks: RockTracks,
    rises: NDArray[np.float32],
    density: Array,
    grid: Grid,
    scale: float,
    height_ratio: float,
) -> Shift | None:
    """Return by how much the rocks are off; None with too few of them on the map.

    Parameters are those of `registered`.
    """
    inside = np.asarray(grid.contains(tracks.xy)) & (tracks.existence > 0.5)
    if np.count_nonzero(inside) < _FEWEST:
        return None
    row, col = (np.asarray(v) for v in grid.cell(tracks.xy[inside]))
    height = scale * np.maximum(tracks.radius[inside], LEAST_RADIUS)
    common = float(np.median(tracks.sigma[inside]))
    top = _highest_near(rises, grid.posting)
    chance = 1.0 - np.searchsorted(np.sort(top, axis=None), _SHOWS * height) / top.size
    chance = np.clip(chance, _RAREST, 1.0 - _RAREST)
    area = _TOP * np.pi * (height / (2.0 * height_ratio)) ** 2
    shows = _TRUE * -np.expm1(-INDEPENDENT * density[row, col] * area)
    hit, miss = np.log((shows + (1.0 - shows) * chance) / chance), np.log1p(-shows)
    steps = _steps(min(_DEVIATIONS * common, _FARTHEST), grid.posting)
    far = grid.posting * steps
    log = -0.5 * (far[:, None] ** 2 + far**2) / max(common, _LEAST) ** 2
    for r, c, h, yes, no in zip(row, col, _SHOWS * height, hit, miss, strict=True):
        # Beyond the edge lies what lies at it.
        near = top[
            np.clip(r + steps, 0, grid.rows - 1)[:, None], np.clip(c + steps, 0, grid.cols - 1)
        ]
        log += np.where(near >= h, yes, no)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    by, variance = [], []
    for axis in (0, 1):
        along = weight.sum(axis=axis)
        by.append(float(along @ far))
        variance.append(float(along @ (far - by[-1]) ** 2))
    return Shift(np.array(by), max(float(np.sqrt(np.mean(variance))), _LEAST), common)


def _highest_near(rises: NDArray[np.float32], posting: float) -> NDArray[np.float32]:
    """Return the highest rise about each cell (rows, cols), m; far below where there is none."""
    half = max(round(_NEAR / posting), 1)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    known = np.where(np.isfinite(rises), rises, np.float32(-1e6))
    return np.asarray(
        ndimage.maximum_filter(
            known, footprint=np.hypot(x, y) * posting <= _NEAR, mode="constant", cval=-1e6
        )
    )


def _steps(far: float, posting: float) -> NDArray[np.int64]:
    """Return whole cells up to a distance both ways (n,)."""
    most = round(far / posting)
    return np.arange(-most, most + 1)
