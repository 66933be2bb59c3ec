"""Terrain raster of a quadtree, and residual heights of its points.

The raster serves tests under every leg of the lander; the residual heights serve the estimate of
undetected rocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.local_planes import LocalPlaneGrid
from lunarsim.onboard.hazards.quadtree._sum_kernels import count_in_squares
from lunarsim.onboard.hazards.quadtree.tree import QuadtreeMap
from lunarsim.typing import Array, BoolArray, IntArray

# Standard deviation of the Gaussian window for the mean terrain between sparse points, in cells.
_WINDOW_SIGMA_CELLS = 3.0
# Minimum weight of points in that window for a cell without points to count as observed.
_MIN_WINDOW_WEIGHT = 1e-3
# Cell size in which points are counted, and width of the window for their density, m.
_CELL_M, _DENSITY_WINDOW_M = 0.2, 1.0
# Distance from a gap up to which the density is evaluated, in such windows.
_SEARCH_WINDOWS = 1.6
# Minimum expected number of points for an empty rectangle to be a gap.
_MIN_EXPECTED_POINTS = 14.0
# Rows and columns of the rectangles, in such cells.
_GAP_SHAPES = (
    *((n, n) for n in (1, 2, 3, 4, 5, 6)),
    *((n, m) for n, m in ((2, 6), (6, 2), (2, 10), (10, 2), (1, 8), (8, 1), (3, 8), (8, 3))),
)
# Maximum number of points for residual heights.
_MAX_SAMPLED_POINTS = 250_000
# Maximum height of an outlier that may be a rock, m.
_MAX_ROCK_OUTLIER_M = 1.0
# Minimum side of the squares for local planes, which are fitted over 5 x 5 squares, m.
_MIN_SQUARE_M = 0.4


def terrain_raster(
    quadtree: QuadtreeMap, smallest: float, largest: float, coverage: SamplingCoverage | None = None
) -> tuple[Array, Grid]:
    """Compute a raster of mean elevations from a quadtree; NaN where not observed.

    Returns the elevations (rows, cols), m, and their grid. Where points are so sparse that quadtree
    cells are larger than the raster, the mean elevation applies to the cell centre, and the slope
    of the surrounding terrain is added.

    Parameters
    ----------
    quadtree
        Map of the points.
    smallest, largest
        Sides of the smallest and largest cells that count as observed, m; the raster has the
        smallest.
    coverage
        Sampling coverage whose gaps are set to NaN; default: no gaps.
    """
    finest = quadtree.depth_of(smallest)
    wide = 1 << finest
    grid = Grid.centred(quadtree.centre[:2], quadtree.side, quadtree.side / wide)
    nodes = quadtree.band(smallest, largest)
    height = quadtree.elevation(nodes) - quadtree.centre[2]
    nodes, height = nodes[np.isfinite(height)], height[np.isfinite(height)]
    t = quadtree.tree
    levels_above = finest - t.depth[nodes].astype(np.int64)
    row, col = t.row[nodes].astype(np.int64), t.column[nodes].astype(np.int64)
    trend = _mean_terrain(row, col, levels_above, height, wide)
    out = np.full((wide, wide), np.nan)
    for level in np.unique(levels_above):
        side = 1 << int(level)
        selected = levels_above == level
        blocks = trend.reshape(wide // side, side, wide // side, side)
        offset = (blocks - blocks.mean(axis=(1, 3), keepdims=True)).reshape(wide, wide)
        for i in range(side):
            for j in range(side):
                at = row[selected] * side + i, col[selected] * side + j
                out[at] = height[selected] + offset[at]
    out = np.where(np.isnan(out), trend, out) + quadtree.centre[2]
    if coverage is not None:
        # The cell counts of both rasters differ by a power of two.
        each = len(coverage.gap) // wide
        out[coverage.gap.reshape(wide, each, wide, each).any(axis=(1, 3))] = np.nan
    return out, grid


def close_holes(height: Array, posting: float, width: float) -> Array:
    """Fill the holes of a terrain raster by a grey closing.

    `height` (rows, cols) are elevations, m, and `posting` is the cell size, m. The closing fills
    holes no wider than `width`, m, along rows or columns. It leaves planes and peaks unchanged and
    raises nothing above the highest terrain nearby. NaN remains.
    """
    cells = 2 * int(np.ceil(0.5 * width / posting)) + 1
    known = ~np.isnan(height)
    filled = ndimage.grey_closing(np.where(known, height, -np.inf), cells, mode="nearest")
    return np.where(known, filled, np.nan)


@dataclass(frozen=True)
class SamplingCoverage:
    """Density of the points of a quadtree map, and the gaps between them.

    Attributes
    ----------
    grid
        Cells of about 0.2 m: the map side divided by a power of two.
    gap
        True where points are missing and chance does not explain it (rows, cols).
    density
        Points per square metre in a window of about 1 m around each cell (rows, cols).
    """

    grid: Grid
    gap: BoolArray
    density: Array


def sampling_coverage(quadtree: QuadtreeMap) -> SamplingCoverage:
    """Compute the point density of a quadtree map and find its gaps.

    A gap is a rectangle of cells without points in which the density on both sides of it predicts
    at least 14.
    """
    wide = 1 << quadtree.depth_of(_CELL_M)
    posting = quadtree.side / wide
    grid = Grid.centred(quadtree.centre[:2], quadtree.side, posting)
    points, half = quadtree.tree.xyz[: quadtree.count], np.float32(0.5 * quadtree.side)
    count = np.zeros((wide, wide), np.int64)
    count_in_squares(points, half, np.float32(posting), count)
    window = max(1, min(wide, round(_DENSITY_WINDOW_M / posting)))
    mean = ndimage.uniform_filter(count.astype(np.float64), window, mode="constant")
    # The density on both sides of a gap, not in it, predicts the points. The coverage of a scan has
    # no concave edges, and next to a scan only coarser ones may have measured.
    search_range = window // 2 + 1, round(_SEARCH_WINDOWS * window)
    expected_density = np.maximum(
        *(_density_on_both_sides(mean, *search_range, axis) for axis in (0, 1))
    )
    total = np.zeros((wide + 1, wide + 1), np.int64)
    np.cumsum(np.cumsum(count, axis=0), axis=1, out=total[1:, 1:])
    gap = np.zeros((wide, wide), np.bool_)
    for height, width in _GAP_SHAPES:
        if max(height, width) > wide:
            continue
        inside = (
            total[height:, width:] - total[:-height, width:] - total[height:, :-width]
            + total[:-height, :-width]
        )  # fmt: skip
        # Density at the centre of each rectangle.
        expected = expected_density[height // 2 :, width // 2 :][
            : wide - height + 1, : wide - width + 1
        ]
        empty = (inside == 0) & (expected * height * width >= _MIN_EXPECTED_POINTS)
        # Mark all cells of an empty rectangle: its rows, then its columns.
        tall = np.zeros((wide, empty.shape[1]), np.bool_)
        for i in range(height):
            tall[i : i + empty.shape[0]] |= empty
        for j in range(width):
            gap[:, j : j + empty.shape[1]] |= tall
    return SamplingCoverage(grid, gap, mean / posting**2)


def _density_on_both_sides(density: Array, near: int, far: int, axis: int) -> Array:
    """Return the smaller of the maximum densities on both sides of each cell.

    `density` and the result are (rows, cols), in points per cell. Each side extends from `near` to
    `far` cells from the cell along `axis`; beyond the map the density is 0.
    """
    lines = np.pad(np.moveaxis(density, axis, -1), ((0, 0), (far, far)))
    wide, length = far - near + 1, density.shape[axis]
    maxima = np.lib.stride_tricks.sliding_window_view(lines, wide, axis=-1).max(axis=-1)
    smaller = np.minimum(maxima[:, :length], maxima[:, far + near :])
    return np.asarray(np.moveaxis(smaller, -1, axis))


def _mean_terrain(
    row: IntArray, col: IntArray, levels_above: IntArray, height: Array, side_count: int
) -> Array:
    """Return the Gaussian-weighted mean elevation around each cell of a raster.

    The raster (side_count, side_count) is computed from quadtree cells with `height` (n,), m. `row`
    and `col` (n,) locate them among cells of their size, which is 2^`levels_above` (n,) times that
    of a raster cell. The result is NaN far from points.
    """
    sums, count = np.zeros((side_count, side_count)), np.zeros((side_count, side_count))
    at = (
        (row << levels_above) + (1 << levels_above >> 1),
        (col << levels_above) + (1 << levels_above >> 1),
    )
    sums[at], count[at] = height, 1.0
    weight = ndimage.gaussian_filter(count, _WINDOW_SIGMA_CELLS, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = ndimage.gaussian_filter(sums, _WINDOW_SIGMA_CELLS, mode="constant") / weight
    return np.where(weight > _MIN_WINDOW_WEIGHT, mean, np.nan)


def residual_heights(quadtree: QuadtreeMap) -> Array:
    """Return the heights of a sample of points above the local terrain plane (n,), m.

    The plane is fitted to about a hundred points around each point, without outliers. Outliers in
    height less than 1 m from the plane are included in the result, because a single return from a
    small rock cannot be distinguished from one in the air; other outliers are omitted.
    """
    t, count = quadtree.tree, quadtree.count
    index = np.arange(0, count, max(1, count // _MAX_SAMPLED_POINTS))
    points, apart = t.xyz[index].astype(np.float64), t.is_outlier[index]
    spacing = quadtree.side / np.sqrt(max(len(points), 1))
    squares = LocalPlaneGrid(
        Grid.centred((0.0, 0.0), quadtree.side, max(_MIN_SQUARE_M, 2.0 * spacing)), 1
    )
    found = points[:, 2] - squares.plane_heights(squares.fit_planes(points[~apart]), points)
    return np.asarray(found[~apart | (np.abs(found) < _MAX_ROCK_OUTLIER_M)])
