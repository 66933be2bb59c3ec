"""Where the rocks of one eye lie in the elevations of another.

From far a camera's rocks are all off by one and the same: a mrad of its direction is 1.5 m of
ground from 1500 m. Each of them is known no better than that, though they lie within decimetres of
their places among each other. So the one shift is sought at which rises are where the rocks are.
With h the probability that samples show a rock, and f that any place looks like one
(`lunarsim.onboard.hazards.fusion.rises`), a rock with a rise speaks for a shift by
``log((h + (1 - h) f) / f)``, one without against it by ``log(1 - h)``. With the shift's own spread
that gives its mean and its covariance: where the elevations tell nothing, both are what they were.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.fusion.heights import LEAST_RADIUS
from lunarsim.onboard.hazards.fusion.rises import Samples
from lunarsim.onboard.hazards.published import RockTracks

Array = NDArray[np.float64]

# Shifts are tried to so many deviations, but not beyond, m.
_DEVIATIONS, _FARTHEST = 3.0, 4.0
# A shift is no better known than that, nor is a rock among the others, m.
_LEAST, _APART = 0.1, 0.15
# Fewer rocks tell no shift.
_FEWEST = 3


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


def registered(tracks: RockTracks, samples: Samples, scale: float) -> RockTracks:
    """Return rocks where the elevations have them; with too few as they were.

    Parameters
    ----------
    tracks
        The rocks.
    samples
        About them.
    scale
        Height of the rocks over their radius.
    """
    shift = shift_of(tracks, samples, scale)
    if shift is None:
        return tracks
    own = np.sqrt(np.maximum(tracks.sigma**2 - shift.common**2, 0.0) + _APART**2)
    sigma = np.minimum(np.hypot(own, shift.sigma), np.maximum(tracks.sigma, _APART))
    return replace(tracks, xy=tracks.xy + shift.by, sigma=sigma)


def shift_of(tracks: RockTracks, samples: Samples, scale: float) -> Shift | None:
    """Return by how much the rocks are off; None with too few of them on the map.

    Parameters are those of `registered`.
    """
    grid = samples.grid
    inside = np.asarray(grid.contains(tracks.xy)) & (tracks.existence > 0.5)
    if np.count_nonzero(inside) < _FEWEST:
        return None
    row, col = (np.asarray(v) for v in grid.cell(tracks.xy[inside]))
    height = scale * np.maximum(tracks.radius[inside], LEAST_RADIUS)
    common = float(np.median(tracks.sigma[inside]))
    rock = samples.showing(height, samples.density[row, col])
    hit, miss = np.log(rock.hit / rock.chance), np.log1p(-rock.shows)
    steps = _steps(min(_DEVIATIONS * common, _FARTHEST), grid.posting)
    far = grid.posting * steps
    log = -0.5 * (far[:, None] ** 2 + far**2) / max(common, _LEAST) ** 2
    # Beyond the edge lies what lies at it.
    wide = np.pad(samples.top, len(steps) // 2, mode="edge")
    for r, c, h, yes, no in zip(row, col, rock.least, hit, miss, strict=True):
        near = wide[r : r + len(steps), c : c + len(steps)]
        log += np.where(near >= h, yes, no)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    by, variance = [], []
    for axis in (0, 1):
        along = weight.sum(axis=axis)
        by.append(float(along @ far))
        variance.append(float(along @ (far - by[-1]) ** 2))
    return Shift(np.array(by), max(float(np.sqrt(np.mean(variance))), _LEAST), common)


def _steps(far: float, posting: float) -> NDArray[np.int64]:
    """Return whole cells up to a distance both ways (n,)."""
    most = round(far / posting)
    return np.arange(-most, most + 1)
