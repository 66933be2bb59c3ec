"""Exact landing safety: every heading, every admissible support plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.hazards.safety import _kernels as k
from lunarsim.hazards.safety.footprint import Footprint, footprint_of
from lunarsim.vehicle.lander import Lander

FloatMap = NDArray[np.float32]
BoolMap = NDArray[np.bool_]


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
    k.maximum(z, 1.0, windows, footprint.depth, footprint.reach, out)
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
    z, observed = known_ground(check_raster("elevation", elevation, grid, footprint), footprint)
    feet = footprint_maximum(z, footprint.pad_windows, footprint)
    tangent = np.zeros(grid.shape, np.float32)
    roughness = np.zeros(grid.shape, np.float32)
    first_run = np.searchsorted(footprint.inside[:, 0], np.arange(len(footprint.legs) + 1))
    legs = footprint.legs
    if heading is not None:
        only = footprint.nearest_heading(lander, grid.posting, heading)
        legs, first_run = legs[only : only + 1], first_run[only : only + 2]
    k.exact(
        z,
        feet,
        legs,
        footprint.inside,
        first_run,
        footprint.reach,
        np.float32(grid.posting),
        tangent,
        roughness,
    )
    slope = np.arctan(tangent)
    slope[~observed] = np.nan
    roughness[~observed] = np.nan
    with np.errstate(invalid="ignore"):
        safe = (slope < lander.slope_limit) & (roughness < lander.roughness_limit)
    return SafetyMap(grid, slope, roughness, safe & observed, observed)
