"""The ground of a quadtree as a raster, and how high its points stand above it.

For tests that look under every leg of the lander, and for the rocks that no point has met.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.planes import Squares
from lunarsim.onboard.hazards.quadtree.tree import QuadtreeMap

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Width of the bell over which the ground is averaged where it was seen thinly, in cells.
_WIDTH = 3.0
# Least weight of points under that bell for ground without a point of its own to count as seen.
_NEAR = 1e-3
# Points that are asked how high they stand.
_ASKED = 250_000
# Least side of the squares through 5 x 5 of which a plane is laid, m.
_SQUARE = 0.4


def surface(quadtree: QuadtreeMap, smallest: float, largest: float) -> tuple[Array, Grid]:
    """Return mean elevations (rows, cols), m, NaN where nothing was seen, and their cells.

    Where the ground was seen so thinly that cells are larger than the raster's, their mean lies in
    their middle and they have the slope of the ground about them.

    Parameters
    ----------
    quadtree
        The map.
    smallest, largest
        Band of cell sizes, m; the raster has the smallest.
    """
    finest = quadtree.depth_of(smallest)
    wide = 1 << finest
    grid = Grid.centred(quadtree.centre[:2], quadtree.side, quadtree.side / wide)
    nodes = quadtree.band(smallest, largest)
    height = quadtree.elevation(nodes) - quadtree.centre[2]
    nodes, height = nodes[np.isfinite(height)], height[np.isfinite(height)]
    t = quadtree.tree
    finer = finest - t.depth[nodes].astype(np.int64)
    row, col = t.row[nodes].astype(np.int64), t.column[nodes].astype(np.int64)
    trend = _trend(row, col, finer, height, wide)
    out = np.full((wide, wide), np.nan)
    for more in np.unique(finer):
        side = 1 << int(more)
        mine = finer == more
        blocks = trend.reshape(wide // side, side, wide // side, side)
        off = (blocks - blocks.mean(axis=(1, 3), keepdims=True)).reshape(wide, wide)
        for i in range(side):
            for j in range(side):
                at = row[mine] * side + i, col[mine] * side + j
                out[at] = height[mine] + off[at]
    return np.where(np.isnan(out), trend, out) + quadtree.centre[2], grid


def _trend(row: IntArray, col: IntArray, finer: IntArray, height: Array, wide: int) -> Array:
    """Return the ground averaged about each cell of a raster (wide, wide); NaN far from points."""
    sums, count = np.zeros((wide, wide)), np.zeros((wide, wide))
    at = (row << finer) + (1 << finer >> 1), (col << finer) + (1 << finer >> 1)
    sums[at], count[at] = height, 1.0
    weight = ndimage.gaussian_filter(count, _WIDTH, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = ndimage.gaussian_filter(sums, _WIDTH, mode="constant") / weight
    return np.where(weight > _NEAR, mean, np.nan)


def rises(quadtree: QuadtreeMap) -> Array:
    """Return heights of some points above the ground about them (n,), m.

    The ground is the plane through some hundred points about; points that stand apart are left out.
    """
    t, count = quadtree.tree, quadtree.count
    index = np.arange(0, count, max(1, count // _ASKED))
    index = index[~t.apart[index]]
    points = t.xyz[index].astype(np.float64)
    spacing = quadtree.side / np.sqrt(max(len(points), 1))
    squares = Squares(Grid.centred((0.0, 0.0), quadtree.side, max(_SQUARE, 2.0 * spacing)), 1)
    return np.asarray(points[:, 2] - squares.heights(squares.planes(points), points))
