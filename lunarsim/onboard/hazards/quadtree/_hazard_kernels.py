# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for hazards: points that leave the terrain planes (Eqs. 3 to 5).

A cell needs a minimum point density to be evaluated. Exceptions are then counted in squares of a
quarter of its side, so that the top of a boulder is a large share of the points in its square.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.onboard.hazards.quadtree._site_kernels import (
    half_steps,
    is_evenly_sampled,
    mesh_height,
    steepest_normal,
)
from lunarsim.onboard.hazards.quadtree._tree_kernels import STACK, cell_centre

# Squares have 1 / 2^SQUARE_LEVELS of the side of the smallest hazard cells.
SQUARE_LEVELS = 2
# Minimum expected number of points for an empty square to count as unobserved, and distance in
# squares up to which neighbours predict that number: up to the next of the smallest cells.
MIN_EXPECTED_POINTS = 12
NEIGHBOUR_SQUARES = 1 << SQUARE_LEVELS


@kernel()
def _distances(tree, node, plane, squares, stack, distance, square):
    """Compute the distances of a cell's points to a plane, without outliers in height.

    `node` is the cell of `tree`. `plane` (6,) is a point on the plane, m, and its unit normal.
    `squares` is the number of squares along a side of the cell, and `stack` a work array.
    `distance` (n,), m, and `square` (n,) receive the signed distance of each point and the index of
    its square. Returns the number of points.
    """
    x, y, z, a, b, c = plane
    reach = tree.half / (1 << tree.depth[node])
    mid_x, mid_y = cell_centre(tree, node)
    per_metre = squares / (2.0 * reach)
    n = 0
    stack[0] = node
    top = 1
    while top > 0:
        top -= 1
        m = stack[top]
        if tree.child[m] >= 0:
            for q in range(4):
                if tree.count[tree.child[m] + q] > 0:
                    stack[top] = tree.child[m] + q
                    top += 1
            continue
        run = tree.head[m]
        while run >= 0:
            begin = tree.start[run]
            for i in range(begin, begin + tree.length[run]):
                if tree.is_outlier[i]:
                    continue
                px, py = np.float64(tree.xyz[i, 0]), np.float64(tree.xyz[i, 1])
                distance[n] = (px - x) * a + (py - y) * b + (tree.xyz[i, 2] - z) * c
                row = min(max(int((py - mid_y + reach) * per_metre), 0), squares - 1)
                col = min(max(int((px - mid_x + reach) * per_metre), 0), squares - 1)
                square[n] = row * squares + col
                n += 1
            run = tree.following[run]
    return n


@kernel()
def _count_exceptions(distance, square, median_distance, tolerance, exception_ratio, max_distance):
    """Compute fraction of exceptions and maximum distance per square of a cell.

    An exception is a point farther than `tolerance` (m) from the terrain plane or from the parallel
    plane at `median_distance` (m). `distance` (n,), m, and `square` (n,) are the results of
    `_distances`. `exception_ratio` (w, w), 0 before the call, receives the fraction of exceptions
    among the points of each of the w x w squares. `max_distance` (w, w), m, also 0 before,
    receives the maximum distance from the parallel plane, or of an exception from either plane.
    Squares without points stay 0.
    """
    squares = exception_ratio.shape[0]
    number = np.zeros((squares, squares))
    for i in range(distance.size):
        row, col = square[i] // squares, square[i] % squares
        number[row, col] += 1.0
        reach = abs(distance[i] - median_distance)
        far = max(abs(distance[i]), reach)
        if far > tolerance:
            exception_ratio[row, col] += 1.0
            reach = far
        max_distance[row, col] = max(max_distance[row, col], reach)
    for row in range(squares):
        for col in range(squares):
            if number[row, col] > 0.0:
                exception_ratio[row, col] /= number[row, col]


@kernel()
def _count_in_square(tree, depth, row, col):
    """Return the number of points in one square of a quadtree; 0 off the map.

    `depth` gives the size of the square; `row` and `col` are counted from the south-west. If the
    square is part of a larger leaf, its points are assumed to be spread evenly.
    """
    wide = 1 << depth
    if not (0 <= row < wide and 0 <= col < wide):
        return 0.0
    node, level = 0, depth
    while level > 0 and tree.child[node] >= 0:
        level -= 1
        node = tree.child[node] + ((col >> level) & 1) + 2 * ((row >> level) & 1)
    return tree.count[node] / (1 << 2 * level)


@kernel()
def _neighbour_count(tree, depth, row, col, row_step, col_step):
    """Return the number of points in the next occupied square in a direction.

    The search starts beside the square (`row`, `col`) of a quadtree level `depth` and moves by
    (`row_step`, `col_step`). The result is the larger of the numbers in the first occupied square
    and in the one behind it, because part of the first may be hidden; -1 if the next
    NEIGHBOUR_SQUARES squares are empty.
    """
    for n in range(1, NEIGHBOUR_SQUARES + 1):
        number = _count_in_square(tree, depth, row + n * row_step, col + n * col_step)
        if number > 0.0:
            far = min(n + 1, NEIGHBOUR_SQUARES)
            return max(
                number, _count_in_square(tree, depth, row + far * row_step, col + far * col_step)
            )
    return -1.0


@kernel()
def _expected_count(tree, depth, row, col):
    """Predict the number of points in a square from its occupied neighbours.

    `depth`, `row` and `col` locate the square. Opposite neighbours are compared, west with east and
    south with north. If both are occupied, the smaller number counts, because a coarser scan may
    begin at the square. If only one is occupied, its number counts. The larger result of the two
    directions is returned; it is inf if no neighbour is occupied, since no scan covers the square.
    """
    most = -1.0
    for up in range(2):
        ahead = _neighbour_count(tree, depth, row, col, up, 1 - up)
        behind = _neighbour_count(tree, depth, row, col, -up, up - 1)
        both = min(ahead, behind) if min(ahead, behind) >= 0.0 else max(ahead, behind)
        most = max(most, both)
    return most if most >= 0.0 else np.inf


@kernel()
def _blank_unobserved(tree, node, exception_ratio, max_distance):
    """Set squares of a cell to NaN that no point hit although points were expected.

    `exception_ratio` and `max_distance` (w, w), the values of the w x w squares of cell `node`, are
    set to NaN where a square without points should contain at least MIN_EXPECTED_POINTS by its
    neighbours: it may be hidden behind a boulder or lie beyond the edge of a scan. Other squares
    without points may be empty by chance and keep their values.
    """
    wide = exception_ratio.shape[0]
    depth = np.int64(tree.depth[node])
    while (1 << (depth - tree.depth[node])) < wide:
        depth += 1
    row0, col0 = np.int64(tree.row[node]) * wide, np.int64(tree.column[node]) * wide
    for row in range(wide):
        for col in range(wide):
            # A leaf with points may have one anywhere.
            if _count_in_square(tree, depth, row0 + row, col0 + col) > 0.0:
                continue
            if _expected_count(tree, depth, row0 + row, col0 + col) >= MIN_EXPECTED_POINTS:
                exception_ratio[row, col] = np.nan
                max_distance[row, col] = np.nan


@kernel()
def _evaluate_cell(tree, node, plane, tolerance, exception_ratio, max_distance):
    """Compute fraction of exceptions and maximum distance per square of a cell.

    `plane` (6,) is a point on the terrain mesh, m, and its normal. A point is an exception if it is
    farther than `tolerance`, m, from this plane, or from the parallel plane at the median of the
    points of the cell. The second plane detects a boulder in a hollow that the mesh does not
    resolve. `exception_ratio` and `max_distance` (w, w) receive the results, NaN where unobserved.
    """
    stack = np.empty(STACK, np.int32)
    distance, square = np.empty(tree.count[node]), np.empty(tree.count[node], np.int32)
    n = _distances(tree, node, plane, exception_ratio.shape[0], stack, distance, square)
    if n == 0:
        exception_ratio[:] = np.nan
        max_distance[:] = np.nan
        return
    median_distance = np.median(distance[:n])
    _count_exceptions(
        distance[:n], square[:n], median_distance, tolerance, exception_ratio, max_distance
    )
    _blank_unobserved(tree, node, exception_ratio, max_distance)


@kernel(inline=True)
def _equal_or_nan(a, b):
    """Return whether two numbers are equal, or both NaN."""
    return a == b or (np.isnan(a) and np.isnan(b))


@kernel()
def _write_squares(exception_ratio, max_distance, row0, col0, exception_ratios, max_distances):
    """Copy the squares of one cell into the rasters; return whether a value changed.

    `exception_ratio` and `max_distance` (w, w), the values of the squares of the cell, are copied
    to the rasters `exception_ratios` and `max_distances` from row `row0` and column `col0` on.
    """
    changed = False
    wide = exception_ratio.shape[0]
    for row in range(wide):
        for col in range(wide):
            new, far = np.float32(exception_ratio[row, col]), np.float32(max_distance[row, col])
            changed |= not _equal_or_nan(exception_ratios[row0 + row, col0 + col], new)
            changed |= not _equal_or_nan(max_distances[row0 + row, col0 + col], far)
            exception_ratios[row0 + row, col0 + col] = new
            max_distances[row0 + row, col0 + col] = far
    return changed


@kernel(parallel=True)
def evaluate_cells(tree, nodes, mesh, tolerance, min_density, exception_ratios, max_distances):
    """Search cells for points off the terrain planes (exceptions), square by square.

    `nodes` (n,) are the indices of the cells, which do not overlap, and `mesh` is
    `TerrainMesh.arrays`. A point is an exception if it is farther than `tolerance` (m) from the
    plane. Each quarter of a cell needs at least `min_density` points per square metre. Two rasters
    of squares receive the results: `exception_ratios` the fraction of exceptions among the points
    of a square, and `max_distances` the maximum distance of a point from the median plane of its
    cell, or of an exception from the mesh if that is larger, m. They are NaN where points are too
    few or there is no plane. Returns which cells have a square whose value changed (n,).
    """
    changed = np.zeros(nodes.size, np.bool_)
    for i in prange(nodes.size):
        node = np.int64(
            nodes[i]
        )  # one integer type for all node arguments, so that functions compile once
        normal = np.empty(3)
        wide = exception_ratios.shape[0] >> tree.depth[node]
        exception_ratio, max_distance = np.zeros((wide, wide)), np.zeros((wide, wide))
        hx, hy = half_steps(tree, node)
        t = (
            steepest_normal(hx, hy, mesh, normal)
            if is_evenly_sampled(tree, node, min_density)
            else -1
        )
        if t < 0:
            exception_ratio[:] = np.nan
            max_distance[:] = np.nan
        else:
            z = mesh_height(hx, hy, mesh, t, tree.half / (1 << tree.depths))
            x, y = cell_centre(tree, node)
            plane = (x, y, z, normal[0], normal[1], normal[2])
            _evaluate_cell(tree, node, plane, tolerance, exception_ratio, max_distance)
        row0, col0 = np.int64(tree.row[node]) * wide, np.int64(tree.column[node]) * wide
        changed[i] = _write_squares(
            exception_ratio, max_distance, row0, col0, exception_ratios, max_distances
        )
    return changed


@kernel()
def blank_squares(outlines, square_side, exception_ratios, max_distances):
    """Set the squares of the hazard rasters within given rectangles to NaN.

    `outlines` (n, 4) are west, east, south and north of the rectangles, and `square_side` is the
    side of a square, in half steps (half sides of the smallest cells). `exception_ratios` and
    `max_distances` (rows, cols) are the rasters. Returns which rectangles contained a square that
    was not NaN (n,).
    """
    changed = np.zeros(outlines.shape[0], np.bool_)
    for i in range(outlines.shape[0]):
        for row in range(outlines[i, 2] // square_side, outlines[i, 3] // square_side):
            for col in range(outlines[i, 0] // square_side, outlines[i, 1] // square_side):
                changed[i] |= not np.isnan(exception_ratios[row, col])
                exception_ratios[row, col] = np.nan
                max_distances[row, col] = np.nan
    return changed
