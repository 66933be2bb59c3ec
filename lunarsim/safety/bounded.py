"""A safety test that is conservative by construction and keeps most safe sites on relief.

The conservative test of the Gaussian DEM paper compares heights with a level plane, so that any
slope of the ground eats into its margin. Here the support planes are the real ones: slope is
exact, and only the search for the highest ground above a plane is simplified, from cells to blocks
of cells. On nearly level ground the level plane bounds the roughness closer; the lower of both
bounds is taken.

Proof that no site called safe is unsafe. Let g be the gradient of an admissible support plane at
some heading, and x a cell of the polygon of the legs. The blocks cover the polygon, so x lies in a
block with centre c, half side s and top B >= z(x). The plane at x is no lower than at c less
``s (|gx| + |gy|)``. So the height of the ground above the plane at x is at most B less the plane at
c plus ``s (|gx| + |gy|)``, which is what the test takes, and the worst over blocks, headings and
planes bounds the exact roughness. At each leg the plane is no lower than the highest ground under
the pad, hence nowhere in the polygon lower than the lowest ground that a pad may touch; the height
of x above it, along its normal or upright, is at most max over U less min over L of Eq. 10: this
bounds the exact roughness too, and so does the smaller of both. The slope is that of the exact
test, which Proposition III.1 bounds by Eq. 11. Hence slope and roughness are under their limits
whenever this test or the conservative one says so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import _kernels as k
from lunarsim.safety import _plane_kernels as pk
from lunarsim.safety.conservative import level_slope
from lunarsim.safety.exact import SafetyMap, differences
from lunarsim.safety.footprint import footprint_of
from lunarsim.safety.raster import ground

BLOCK_SIDE = 0.5  # m: a compromise between work and margin


def bounded_safety(
    elevation: ArrayLike, grid: Grid, lander: Lander, *, block_side: float = BLOCK_SIDE
) -> SafetyMap:
    """Evaluate slope exactly and bound roughness from above, by real support planes and level ones.

    A cell called safe is safe by `exact_safety`, and every cell that `conservative_safety` calls
    safe is; see the proof at the head of this module.

    Parameters
    ----------
    elevation, grid, lander
        As in `exact_safety`.
    block_side
        Side of the blocks, m, rounded to whole cells. One cell makes the bound exact.

    Raises
    ------
    InputError
        As `exact_safety`, and if `block_side` is not positive.
    """
    footprint = footprint_of(lander, grid.posting)
    height = ground("elevation", elevation, grid, footprint)
    block = footprint.block_cells(block_side, grid.posting)
    span, rise = differences(height, footprint)
    observed = rise < k.FAR
    tangent, roughness = (np.empty(grid.shape, np.float32) for _ in range(2))
    pk.bounded(
        height.double,
        height.middle,
        footprint.cells,
        footprint.covers(block),
        block,
        np.float32(grid.posting),
        tangent,
        roughness,
    )
    # Equal but for rounding where the ground is level; then either will do.
    slope = np.minimum(np.arctan(tangent), level_slope(span, footprint))
    roughness = np.minimum(roughness, np.maximum(rise, np.float32(0.0)))
    safe = observed & (slope < lander.slope_limit) & (roughness < lander.roughness_limit)
    slope[~observed] = np.nan
    roughness[~observed] = np.nan
    return SafetyMap(grid, slope, roughness, safe, observed)
