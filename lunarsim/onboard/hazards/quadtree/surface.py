"""The ground of a quadtree as a raster, and how high its points stand above it.

For tests that look under every leg of the lander, and for the rocks that no point has met.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.planes import Squares
from lunarsim.onboard.hazards.quadtree._sum_kernels import count_in_squares
from lunarsim.onboard.hazards.quadtree.tree import QuadtreeMap

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Width of the bell over which the ground is averaged where it was seen thinly, in cells.
_BELL = 3.0
# Least weight of points under that bell for ground without a point of its own to count as seen.
_NEAR = 1e-3
# Cells in which points are counted, and width over which their density is, m.
_FINE, _WINDOW = 0.2, 1.0
# How far aside of a hole the density about it is looked for, in such widths.
_ASIDE = 1.6
# Points that must be expected in an empty rectangle for it to be a gap.
_EXPECTED = 14.0
# Its rows and columns of such cells.
_SHAPES = (
    *((n, n) for n in (1, 2, 3, 4, 5, 6)),
    *((n, m) for n, m in ((2, 6), (6, 2), (2, 10), (10, 2), (1, 8), (8, 1), (3, 8), (8, 3))),
)
# Points that are asked how high they stand.
_ASKED = 250_000
# Height of what stands apart that may be a rock, m.
_LOW = 1.0
# Least side of the squares through 5 x 5 of which a plane is laid, m.
_SQUARE = 0.4


def surface(
    quadtree: QuadtreeMap, smallest: float, largest: float, seen: Sampling | None = None
) -> tuple[Array, Grid]:
    """Return mean elevations (rows, cols), m, NaN where nothing was seen, and their cells.

    Where the ground was seen so thinly that cells are larger than the raster's, their mean lies in
    their middle and they have the slope of the ground about them.

    Parameters
    ----------
    quadtree
        The map.
    smallest, largest
        Band of cell sizes, m; the raster has the smallest.
    seen
        Gaps to leave out; left out: none.
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
    out = np.where(np.isnan(out), trend, out) + quadtree.centre[2]
    if seen is not None:
        # Cells of the one are a power of two of the other's.
        each = len(seen.gap) // wide
        out[seen.gap.reshape(wide, each, wide, each).any(axis=(1, 3))] = np.nan
    return out, grid


def without_holes(height: Array, posting: float, width: float) -> Array:
    """Return ground (rows, cols) with what lies deeper than its surroundings filled.

    Holes are filled that are no wider than `width`, m, along rows or columns: a grey closing. It
    leaves planes and tops as they are, and raises nothing above the highest ground that near. NaN
    stays.
    """
    cells = 2 * int(np.ceil(0.5 * width / posting)) + 1
    known = ~np.isnan(height)
    filled = ndimage.grey_closing(np.where(known, height, -np.inf), cells, mode="nearest")
    return np.where(known, filled, np.nan)


@dataclass(frozen=True)
class Sampling:
    """How densely a map was seen.

    Attributes
    ----------
    grid
        Cells of `_FINE` (power of two parts of the map).
    gap
        Where points are missing that chance would not have left out (rows, cols).
    density
        Points on a square metre about each cell, over `_WINDOW` (rows, cols).
    """

    grid: Grid
    gap: NDArray[np.bool_]
    density: Array


def sampling(quadtree: QuadtreeMap) -> Sampling:
    """Return how densely a map was seen, and where it was not.

    A hole is an empty rectangle in which the density about it lets expect `_EXPECTED` points.
    """
    wide = 1 << quadtree.depth_of(_FINE)
    posting = quadtree.side / wide
    grid = Grid.centred(quadtree.centre[:2], quadtree.side, posting)
    points, half = quadtree.tree.xyz[: quadtree.count], np.float32(0.5 * quadtree.side)
    count = np.zeros((wide, wide), np.int64)
    count_in_squares(points, half, np.float32(posting), count)
    window = max(1, min(wide, round(_WINDOW / posting)))
    mean = ndimage.uniform_filter(count.astype(np.float64), window, mode="constant")
    # What lies on both sides of a hole, not in it, tells what to expect there: what a scan covers
    # has no bays, and beside it only coarser ones came.
    aside = window // 2 + 1, round(_ASIDE * window)
    about = np.maximum(*(_on_both_sides(mean, *aside, axis) for axis in (0, 1)))
    total = np.zeros((wide + 1, wide + 1), np.int64)
    np.cumsum(np.cumsum(count, axis=0), axis=1, out=total[1:, 1:])
    gap = np.zeros((wide, wide), np.bool_)
    for high, across in _SHAPES:
        if max(high, across) > wide:
            continue
        inside = (
            total[high:, across:] - total[:-high, across:] - total[high:, :-across]
            + total[:-high, :-across]
        )  # fmt: skip
        # Expected by what lies about the middle of a rectangle.
        here = about[high // 2 :, across // 2 :][: wide - high + 1, : wide - across + 1]
        empty = (inside == 0) & (here * high * across >= _EXPECTED)
        # All squares of an empty rectangle: its rows, then its columns.
        tall = np.zeros((wide, empty.shape[1]), np.bool_)
        for i in range(high):
            tall[i : i + empty.shape[0]] |= empty
        for j in range(across):
            gap[:, j : j + empty.shape[1]] |= tall
    return Sampling(grid, gap, mean / posting**2)


def _on_both_sides(density: Array, near: int, far: int, axis: int) -> Array:
    """Return the lesser of the greatest densities from `near` to `far` cells before and behind."""
    lines = np.pad(np.moveaxis(density, axis, -1), ((0, 0), (far, far)))
    wide, length = far - near + 1, density.shape[axis]
    most = np.lib.stride_tricks.sliding_window_view(lines, wide, axis=-1).max(axis=-1)
    least = np.minimum(most[:, :length], most[:, far + near :])
    return np.asarray(np.moveaxis(least, -1, axis))


def _trend(row: IntArray, col: IntArray, finer: IntArray, height: Array, wide: int) -> Array:
    """Return the ground averaged about each cell of a raster (wide, wide); NaN far from points."""
    sums, count = np.zeros((wide, wide)), np.zeros((wide, wide))
    at = (row << finer) + (1 << finer >> 1), (col << finer) + (1 << finer >> 1)
    sums[at], count[at] = height, 1.0
    weight = ndimage.gaussian_filter(count, _BELL, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = ndimage.gaussian_filter(sums, _BELL, mode="constant") / weight
    return np.where(weight > _NEAR, mean, np.nan)


def rises(quadtree: QuadtreeMap) -> Array:
    """Return heights of some points above the ground about them (n,), m.

    The ground is the plane through some hundred points about, without those that stand apart. Of
    these the ones less than `_LOW` above it count as well: one return off a small rock cannot be
    told from one off something in the air.
    """
    t, count = quadtree.tree, quadtree.count
    index = np.arange(0, count, max(1, count // _ASKED))
    points, apart = t.xyz[index].astype(np.float64), t.apart[index]
    spacing = quadtree.side / np.sqrt(max(len(points), 1))
    squares = Squares(Grid.centred((0.0, 0.0), quadtree.side, max(_SQUARE, 2.0 * spacing)), 1)
    found = points[:, 2] - squares.heights(squares.planes(points[~apart]), points)
    return np.asarray(found[~apart | (np.abs(found) < _LOW)])
