"""Exact landing safety: every heading, every admissible support plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim._lanes import LANES
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import _kernels as k
from lunarsim.safety import _plane_kernels as pk
from lunarsim.safety.footprint import BLOCK, Footprint, footprint_of

FloatMap = NDArray[np.float32]
BoolMap = NDArray[np.bool_]

# Of the heights' size: what a few float32 operations may lose.
_ROUNDING = np.float32(1e-6)


@dataclass(frozen=True)
class SafetyMap:
    """Slope, roughness and safety of a lander centred on each cell.

    Attributes
    ----------
    grid
        Places the cells.
    slope
        Worst slope (rows, cols), rad; NaN where not observed.
    roughness
        Worst roughness (rows, cols), m; NaN where not observed.
    safe
        True where both are under the lander's limits (rows, cols).
    observed
        False where the footprint leaves the map or covers unknown ground (rows, cols).
    """

    grid: Grid
    slope: FloatMap
    roughness: FloatMap
    safe: BoolMap
    observed: BoolMap


def check_raster(name: str, z: ArrayLike, grid: Grid, footprint: Footprint) -> FloatMap:
    """Return `z` as float32, or raise ValueError if it does not fit the grid or the lander."""
    raster = np.ascontiguousarray(z, dtype=np.float32)
    if raster.shape != grid.shape:
        raise ValueError(f"{name} has shape {raster.shape}, the grid {grid.shape}")
    if min(grid.shape) <= 2 * footprint.reach:
        side = (2 * footprint.reach + 1) * grid.posting
        raise ValueError(
            f"grid of {grid.shape} cells: must be larger than the footprint, {side:.2f} m"
        )
    return raster


def check_variance(variance: ArrayLike, grid: Grid, footprint: Footprint) -> FloatMap:
    """Return a variance raster as float32, or raise ValueError as `check_raster` or if negative."""
    raster = check_raster("variance", variance, grid, footprint)
    least = float(np.nanmin(raster, initial=0.0))
    if least < 0.0:
        raise ValueError(f"variance = {least}: must not be negative")
    return raster


def known_ground(z: FloatMap, footprint: Footprint) -> tuple[FloatMap, BoolMap]:
    """Return `z` with unknown ground set to 0, and where whole footprints are known."""
    unknown = ~np.isfinite(z)
    observed = np.zeros(z.shape, np.bool_)
    r = footprint.reach
    observed[r:-r, r:-r] = True
    if unknown.any():
        marks = unknown.astype(np.float32)
        for windows in (footprint.body_windows, footprint.leg_windows):
            observed &= footprint_maximum(marks, windows, footprint) == 0.0
        z = np.where(unknown, np.float32(0.0), z)
    return z, observed


def footprint_maximum(z: FloatMap, windows: NDArray[np.int64], footprint: Footprint) -> FloatMap:
    """Return the maximum of `z` over a set of windows around each cell; FAR off the raster."""
    out = np.empty(z.shape, np.float32)
    k.maximum(z, windows, footprint.depth, footprint.reach, out)
    return out


def exact_safety(
    elevation: ArrayLike, grid: Grid, lander: Lander, *, heading: float | None = None
) -> SafetyMap:
    """Evaluate Definition III.1 of the Gaussian DEM paper on a grid.

    At each heading the pads rest on the highest ground under them; slope (Eq. 8) and roughness
    (Eq. 9, over the polygon of the legs) are the worst over the admissible support planes
    (`lunarsim.vehicle.touchdown.support_planes`). Legs keep their horizontal place (Eq. 19).

    Parameters
    ----------
    elevation
        Elevation (rows, cols), m; NaN for unknown.
    grid
        Places the elevation.
    lander
        Geometry and limits.
    heading
        Azimuth of body x (rad) to evaluate one heading only; left out, all of them.

    Raises
    ------
    ValueError
        If shapes differ, or the grid is smaller than the footprint.
    """
    footprint = footprint_of(lander, grid.posting)
    if heading is not None:
        index = footprint.nearest_heading(lander, grid.posting, heading)
        footprint = footprint.one_heading(index)
    z, observed = known_ground(check_raster("elevation", elevation, grid, footprint), footprint)
    tangent, roughness = _evaluate(z, observed, footprint, lander, grid.posting, False)
    slope = np.arctan(tangent)
    safe = observed & (slope < lander.slope_limit) & (roughness < lander.roughness_limit)
    slope[~observed] = np.nan
    roughness[~observed] = np.nan
    return SafetyMap(grid, slope, roughness, safe, observed)


def safe_sites(elevation: ArrayLike, grid: Grid, lander: Lander) -> tuple[BoolMap, BoolMap]:
    """Decide exact safety alone: where `exact_safety` would say safe, sooner.

    Sites that the conservative test passes need no more; the others are left as soon as a limit
    is passed. Parameters and errors are those of `exact_safety`.

    Returns
    -------
    safe, observed
        As in `SafetyMap` (rows, cols).
    """
    footprint = footprint_of(lander, grid.posting)
    z, observed = known_ground(check_raster("elevation", elevation, grid, footprint), footprint)
    leg_max, leg_min, body_max = footprint_extremes(z, footprint)
    span = leg_max - leg_min
    sure = (span < footprint.least_height * np.sin(lander.slope_limit)) & (
        body_max - leg_min < lander.roughness_limit
    )
    todo = observed & ~sure
    tangent, roughness = _evaluate(z, todo, footprint, lander, grid.posting, True)
    passed = (np.arctan(tangent) < lander.slope_limit) & (roughness < lander.roughness_limit)
    return observed & (sure | passed), observed


def footprint_extremes(z: FloatMap, footprint: Footprint) -> tuple[FloatMap, FloatMap, FloatMap]:
    """Return max over L, min over L, max over U (Eq. 10) around each cell; FAR where unknown."""
    leg_max, leg_min, body_max = (np.empty(z.shape, np.float32) for _ in range(3))
    k.extremes(
        z,
        footprint.leg_windows,
        footprint.body_windows,
        footprint.depth,
        footprint.reach,
        leg_max,
        leg_min,
        body_max,
    )
    return leg_max, leg_min, body_max


def flat(raster: FloatMap) -> FloatMap:
    """Return a raster row by row, with as much behind it as a kernel may read ahead."""
    ahead = np.zeros(BLOCK * raster.shape[1] + LANES, np.float32)
    return np.concatenate((raster.ravel(), ahead))


def highest(z: FloatMap, block: int) -> FloatMap:
    """Return the highest ground in block x block cells to the north-east of each cell, flat."""
    tops = np.zeros(z.size + LANES, np.float32)
    pk.block_tops(z, block, tops)
    return tops


def _evaluate(
    z: FloatMap,
    todo: BoolMap,
    footprint: Footprint,
    lander: Lander,
    posting: float,
    decide: bool,
) -> tuple[FloatMap, FloatMap]:
    """Return tan(slope) and roughness of the sites to do, 0 elsewhere."""
    feet = footprint_maximum(z, footprint.pad_windows, footprint)
    covers, supports = footprint.covers(BLOCK), footprint.supports
    limit = np.float32(lander.roughness_limit)
    tangent = np.zeros(z.shape, np.float32)
    roughness = np.zeros(z.shape, np.float32)
    pk.exact(
        flat(z),
        flat(feet),
        highest(z, BLOCK),
        todo,
        footprint.legs @ (z.shape[1], 1),
        supports.inverse,
        supports.place,
        covers.corners @ (z.shape[1], 1),
        covers.centres,
        covers.corners.ravel(),
        covers.allowed,
        covers.first,
        np.float32(posting),
        footprint.reach,
        _ROUNDING * np.abs(z).max(),
        np.float32(np.tan(lander.slope_limit)),
        # What reaches the limit passes it: a decision asks for more than this.
        np.nextafter(limit, np.float32(0.0)) if decide else limit,
        decide,
        tangent,
        roughness,
    )
    return tangent, roughness
