"""Rocks that one eye tracks, looked for in the elevations of another.

A hazardous rock raises the ground. Where elevations were measured densely about a rock that
is tracked, and they show no rise of even half the lander's limit, either no rock stands there, or
one too low to matter, or all samples missed it. The odds that a hazardous rock stands there are
multiplied by the chance of the last. A rock that the elevations do show keeps its odds: what is
seen twice is not seen better for that, and the elevations count it already.

A rock is sought by its place relative to the lander: both maps lie in its local frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.published import ReliefEvidence, RockTracks

Array = NDArray[np.float64]

# Both eyes miss a rock for one reason at least so often: flat on the far side, dark as the ground.
COMMON = 0.05
# A rise of this share of the lander's limit shows.
_SHOWS = 0.5
# Share of the area of a half ellipsoid that stands above half its height.
_TOP = 0.75
# Rocks are sought so many deviations about their places, and cells.
_WITHIN, _CELLS = 2.0, 1.0
# Rocks are not taken to be smaller than that, m.
_LEAST_RADIUS = 0.1
# The ground about a rock is a mean over so many times the legs' radius.
_ABOUT = 3.0


def existence_given_relief(tracks: RockTracks, relief: ReliefEvidence, lander: Lander) -> Array:
    """Return the probability that each rock is one that matters (n,), given the elevations.

    Never more than it was; as it was where a rise shows, where not all ground about the rock was
    measured, or where nothing is known of the samples.

    Parameters
    ----------
    tracks
        The rocks.
    relief
        The elevations, and how densely they were measured.
    lander
        Its limits.
    """
    drawn = relief.surface
    if relief.judged is None or drawn.elevation is None or not len(tracks.radius):
        return tracks.existence.copy()
    rise = _above_ground(drawn.elevation.astype(np.float64), drawn.grid, lander)
    least = _SHOWS * lander.roughness_limit
    spread = np.sqrt(tracks.radius_variance)
    within = tracks.radius + _WITHIN * np.hypot(tracks.sigma, spread)
    top = _TOP * np.pi * np.maximum(tracks.radius - spread, _LEAST_RADIUS) ** 2
    missed = np.ones(len(within))
    for n, (xy, reach) in enumerate(zip(tracks.xy, within, strict=True)):
        about = _disc(drawn.grid, xy, float(reach) + _CELLS * drawn.grid.posting)
        if about is None:
            continue
        heights = rise[about]
        if np.isfinite(heights).all() and np.ptp(heights) < least:
            density = float(relief.judged.density[about].min())
            missed[n] = np.exp(-density * top[n])
    missed = COMMON + (1.0 - COMMON) * missed
    odds = missed * tracks.existence / np.maximum(1.0 - tracks.existence, 1e-12)
    return np.where(missed < 1.0, odds / (1.0 + odds), tracks.existence)


def _above_ground(z: Array, grid: Grid, lander: Lander) -> Array:
    """Return how far elevations (rows, cols) stand above those about them; NaN where unknown, m."""
    width = 2 * round(0.5 * _ABOUT * lander.leg_radius / grid.posting) + 1
    known = np.isfinite(z)
    share = ndimage.uniform_filter(known.astype(np.float64), width, mode="constant")
    total = ndimage.uniform_filter(np.where(known, z, 0.0), width, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(z - total / share)


def _disc(grid: Grid, xy: Array, radius: float) -> tuple[NDArray[np.int64], ...] | None:
    """Return rows and columns (k,) of the cells within a disc; None if it leaves the grid."""
    west, east, south, north = grid.extent
    if not (
        west <= xy[0] - radius
        and xy[0] + radius <= east
        and south <= xy[1] - radius
        and xy[1] + radius <= north
    ):
        return None
    (r0, c0), (r1, c1) = (
        tuple(int(v) for v in grid.cell(xy + sign * radius)) for sign in (-1.0, 1.0)
    )
    row, col = np.mgrid[r0 : min(r1, grid.rows - 1) + 1, c0 : min(c1, grid.cols - 1) + 1]
    off = grid.centre_of(row, col) - xy
    near = np.hypot(off[..., 0], off[..., 1]) <= radius
    return row[near], col[near]
