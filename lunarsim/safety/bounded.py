"""A safety test that is conservative and keeps most safe sites on slopes.

The conservative test of the Gaussian DEM paper compares heights with a horizontal plane, so that
any slope of the terrain reduces its margin. This test uses the real support planes: the slope is
exact, and only the search for the maximum height above a plane is simplified, from cells to blocks
of cells. On nearly flat terrain the horizontal plane bounds the roughness more tightly; the lower
of both bounds is used.

Proof that no site classified as safe is unsafe. Let g be the gradient of an admissible support
plane at some heading, and x a cell of the polygon of the legs. The blocks cover the polygon, so x
lies in a block with centre c, half side s and maximum B >= z(x). The plane at x is not below its
height at c minus ``s (|gx| + |gy|)``. The height of the terrain above the plane at x is therefore
at most B minus the plane's height at c plus ``s (|gx| + |gy|)``, which the test computes;
the maximum over blocks, headings and planes bounds the exact roughness. At each leg the plane is
not below the highest terrain under the pad. Everywhere in the polygon it is therefore not below
the lowest terrain that a pad may touch. The height of x above it, along its normal
or vertical, is at most max over U minus min over L of Eq. 10. This also bounds the exact roughness,
and so does the minimum of both. The slope is that of the exact test, which Proposition III.1 bounds
by Eq. 11. Hence slope and roughness are below their limits if this test or the conservative one
classifies a site as safe.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import _kernels as k
from lunarsim.safety import _plane_kernels as pk
from lunarsim.safety.conservative import level_slope
from lunarsim.safety.exact import SafetyMap, height_differences
from lunarsim.safety.footprint import footprint_of
from lunarsim.safety.raster import prepare_elevation

# Compromise between computing time and margin.
BLOCK_SIDE = 0.5  # m


def bounded_safety(
    elevation: ArrayLike, grid: Grid, lander: Lander, *, block_side: float = BLOCK_SIDE
) -> SafetyMap:
    """Evaluate the exact slope and an upper bound of roughness around each cell.

    The roughness bound is the lower of two bounds: by the real support planes and by a horizontal
    plane. Each cell that this test classifies as safe is safe by `exact_safety`. Each cell that
    `conservative_safety` classifies as safe is safe by this test. The module docstring has the
    proof.

    Parameters
    ----------
    elevation, grid, lander
        Elevation (rows, cols), m, with NaN where unknown; grid of the elevation; lander with its
        limits.
    block_side
        Side of the blocks, m, rounded to complete cells. One cell makes the bound exact.

    Raises
    ------
    InputError
        If the elevation is invalid for the grid, the grid is smaller than the footprint, or
        `block_side` is not positive.
    """
    footprint = footprint_of(lander, grid.posting)
    height = prepare_elevation("elevation", elevation, grid, footprint)
    block = footprint.block_cells(block_side, grid.posting)
    span, rise = height_differences(height, footprint)
    observed = rise < k.FAR
    tangent, roughness = (np.empty(grid.shape, np.float32) for _ in range(2))
    pk.bounded(
        height.z_float64,
        height.middle,
        footprint.cells,
        footprint.covers(block),
        block,
        np.float32(grid.posting),
        tangent,
        roughness,
    )
    # On flat terrain they are equal up to rounding.
    slope = np.minimum(np.arctan(tangent), level_slope(span, footprint))
    roughness = np.minimum(roughness, np.maximum(rise, np.float32(0.0)))
    safe = observed & (slope < lander.slope_limit) & (roughness < lander.roughness_limit)
    slope[~observed] = np.nan
    roughness[~observed] = np.nan
    return SafetyMap(grid, slope, roughness, safe, observed)
