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
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import _plane_kernels as pk
from lunarsim.safety.exact import (
    SafetyMap,
    check_raster,
    flat,
    footprint_maximum,
    highest,
    known_ground,
)
from lunarsim.safety.footprint import Footprint, footprint_of

FloatMap = NDArray[np.float32]

BLOCK_SIDE = 0.5  # m: a compromise between work and margin


def bound_planes(
    tops: FloatMap, feet: FloatMap, footprint: Footprint, block: int, posting: float
) -> tuple[FloatMap, FloatMap]:
    """Return tan(slope) and the bound of the roughness (m), 0 near the edge.

    Parameters
    ----------
    tops
        Highest ground in block x block cells to the north-east of each cell, flat, m.
    feet
        Ground on which a pad centred on each cell stands (rows, cols), m.
    footprint
        The lander's.
    block
        Side of the blocks, cells.
    posting
        m.
    """
    covers, supports = footprint.covers(block), footprint.supports
    tangent, roughness = np.zeros(feet.shape, np.float32), np.zeros(feet.shape, np.float32)
    pk.bounded(
        tops,
        feet.shape,
        flat(feet),
        footprint.legs @ (feet.shape[1], 1),
        supports.inverse,
        supports.place,
        covers.corners @ (feet.shape[1], 1),
        covers.centres,
        covers.first,
        block,
        footprint.reach,
        np.float32(posting),
        tangent,
        roughness,
    )
    return tangent, roughness


def bounded_safety(
    elevation: ArrayLike, grid: Grid, lander: Lander, *, block_side: float = BLOCK_SIDE
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
    footprint = footprint_of(lander, grid.posting)
    z, observed = known_ground(check_raster("elevation", elevation, grid, footprint), footprint)
    block = footprint.block_cells(block_side, grid.posting)
    feet = footprint_maximum(z, footprint.pad_windows, footprint)
    tangent, roughness = bound_planes(highest(z, block), feet, footprint, block, grid.posting)
    slope = np.arctan(tangent)
    safe = observed & (slope < lander.slope_limit) & (roughness < lander.roughness_limit)
    slope[~observed] = np.nan
    roughness[~observed] = np.nan
    return SafetyMap(grid, slope, roughness, safe, observed)
