"""A safety test that is conservative by construction and keeps most safe sites on relief.

The conservative test of the Gaussian DEM paper compares heights with a level plane, so that any
slope of the ground eats into its margin. Here the support planes are the real ones: slope is
exact, and only the search for the highest ground above a plane is simplified, from cells to blocks
of cells.

Proof that no site called safe is unsafe. Let g be the gradient of an admissible support plane at
some heading, and x a cell of the polygon of the legs. The blocks cover the polygon, so x lies in a
block with centre c, half side s and top B >= z(x). The plane at x is no lower than at c less
``s (|gx| + |gy|)``. So the height of the ground above the plane at x is at most B less the plane at
c plus ``s (|gx| + |gy|)``, which is what the test takes, and the worst over blocks, headings and
planes bounds the exact roughness. The slope is that of the exact test. Hence both are under their
limits whenever the test says so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.grid import Grid
from lunarsim.hazards.safety import _kernels as k
from lunarsim.hazards.safety.exact import (
    SafetyMap,
    check_raster,
    footprint_maximum,
    known_ground,
)
from lunarsim.hazards.safety.footprint import footprint_of
from lunarsim.vehicle.lander import Lander

_BLOCK_SIDE = 0.5  # m: a compromise between work and margin


def bounded_safety(
    elevation: ArrayLike, grid: Grid, lander: Lander, *, block_side: float = _BLOCK_SIDE
) -> SafetyMap:
    """Evaluate slope exactly and bound roughness from above through the real support planes.

    A cell called safe is safe by `exact_safety`; see the proof at the head of this module.

    Parameters
    ----------
    elevation, grid, lander
        As in `exact_safety`.
    block_side
        Side of the blocks, m, rounded to whole cells. One cell makes the bound exact.

    Raises
    ------
    ValueError
        As `exact_safety`, and if `block_side` is not positive.
    """
    if not (np.isfinite(block_side) and block_side > 0.0):
        raise ValueError(f"block_side = {block_side}: must be a positive length in metres")
    footprint = footprint_of(lander, grid.posting)
    z, observed = known_ground(check_raster("elevation", elevation, grid, footprint), footprint)
    block = max(1, min(round(block_side / grid.posting), footprint.reach))
    feet = footprint_maximum(z, footprint.pad_windows, footprint)
    blocks = np.empty(z.shape, np.float32)
    k.block_tops(z, block, blocks)
    corners, first = footprint.covers(block)
    tangent = np.zeros(z.shape, np.float32)
    roughness = np.zeros(z.shape, np.float32)
    k.bounded(
        blocks,
        feet,
        footprint.legs,
        corners,
        first,
        block,
        footprint.reach,
        np.float32(grid.posting),
        tangent,
        roughness,
    )
    slope = np.arctan(tangent)
    safe = observed & (slope < lander.slope_limit) & (roughness < lander.roughness_limit)
    slope[~observed] = np.nan
    roughness[~observed] = np.nan
    return SafetyMap(grid, slope, roughness, safe, observed)
