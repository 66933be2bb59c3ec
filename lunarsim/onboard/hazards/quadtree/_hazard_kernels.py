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

# Squares have 1 / 2^FINER of the side of the smallest hazard cells.
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
def _count_exceptions(distance, square, middle, tolerance, share, max_distance):
    """Compute the fraction of outliers and the maximum distance per square of a cell.

    An outlier (exception) is a point farther than `tolerance` from a plane or from the parallel
    plane offset by `middle`, m. `distance` (n,), m, and `square` (n,) are the results of
    `_distances`. `share` (w, w) receives the fraction of outliers. `max_distance` (w, w), m,
    receives the maximum distance from the parallel plane, or of an outlier from either plane.
    """
    squares = share.shape[0]
    number = np.zeros((squares, squares))
    for i in range(distance.size):
        row, col = square[i] // squares, square[i] % squares
        number[row, col] += 1.0
        reach = abs(distance[i] - middle)
        far = max(abs(distance[i]), reach)
        if far > tolerance:
            share[row, col] += 1.0
            reach = far
        max_distance[row, col] = max(max_distance[row, col], reach)
    for row in range(squares):
        for col in range(squares):
            if number[row, col] > 0.0:
                share[row, col] /= number[row, col]


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
def _neighbour_count(tree, depth, row, col, up, right):
    """Return the number of points in the next occupied square in a direction.

    The search starts at the square (`row`, `col`) of a depth and moves by (`up`, `right`) per step.
    The result is the larger number of this and the following square, because half of the first may
    be hidden too; -1 if all squares within reach are empty.
    """
    for n in range(1, NEIGHBOUR_SQUARES + 1):
        number = _count_in_square(tree, depth, row + n * up, col + n * right)
        if number > 0.0:
            far = min(n + 1, NEIGHBOUR_SQUARES)
            return max(number, _count_in_square(tree, depth, row + far * up, col + far * right))
    return -1.0


@kernel()
def _expected_count(tree, depth, row, col):
    """Predict the number of points in a square from its occupied neighbours.

    `depth`, `row` and `col` locate the square. The coverage of a scan has no concave edges: between
    two observed squares the density is the same. Next to a scan, only coarser scans may have
    measured, so the smaller number of both sides is used. With one occupied side, its number is
    used. If no side is occupied, no scan covers the square and the result is inf.
    """
    most = -1.0
    for up in range(2):
        ahead = _neighbour_count(tree, depth, row, col, up, 1 - up)
        behind = _neighbour_count(tree, depth, row, col, -up, up - 1)
        both = min(ahead, behind) if min(ahead, behind) >= 0.0 else max(ahead, behind)
        most = max(most, both)
    return most if most >= 0.0 else np.inf


@kernel()
def _blank_unobserved(tree, node, ratio, relief):
    """Set the empty squares of a cell to NaN unless they may be empty by chance.

    `ratio` and `relief` (w, w) are the values of the squares of cell `node`. An unobserved square
    may be hidden behind a boulder or lie beyond the edge of a scan.
    """
    wide = ratio.shape[0]
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
                ratio[row, col] = np.nan
                relief[row, col] = np.nan


@kernel()
def _evaluate_cell(tree, node, plane, tolerance, ratio, relief):
    """Compute the fraction of outliers and the maximum distance per square of a cell.

    `plane` (6,) is a point on the terrain mesh, m, and its normal. A point is an outlier
    (exception) if it is farther than `tolerance`, m, from this plane, or from the parallel plane at
    the median of the points of the cell. The mesh plane alone would miss a boulder in a hollow, and
    the floor of a crater is an outlier only relative to one of them. A boulder on less than half
    the cell hardly raises the median. `ratio` and `relief` (w, w) receive the results, NaN where
    unobserved.
    """
    stack = np.empty(STACK, np.int32)
    off, square = np.empty(tree.count[node]), np.empty(tree.count[node], np.int32)
    n = _distances(tree, node, plane, ratio.shape[0], stack, off, square)
    if n == 0:
        ratio[:] = np.nan
        relief[:] = np.nan
        return
    middle = np.median(off[:n])
    _count_exceptions(off[:n], square[:n], middle, tolerance, ratio, relief)
    _blank_unobserved(tree, node, ratio, relief)


@kernel(inline=True)
def _equal_or_nan(a, b):
    """Return whether two numbers are equal, or both NaN."""
    return a == b or (np.isnan(a) and np.isnan(b))


@kernel()
def _write_squares(ratio, relief, row0, col0, ratios, reliefs):
    """Copy the squares of one cell into the rasters; return whether a value changed.

    `ratio` and `relief` (w, w) are copied to `ratios` and `reliefs` at row `row0` and column
    `col0`.
    """
    changed = False
    wide = ratio.shape[0]
    for row in range(wide):
        for col in range(wide):
            new, far = np.float32(ratio[row, col]), np.float32(relief[row, col])
            changed |= not _equal_or_nan(ratios[row0 + row, col0 + col], new)
            changed |= not _equal_or_nan(reliefs[row0 + row, col0 + col], far)
            ratios[row0 + row, col0 + col] = new
            reliefs[row0 + row, col0 + col] = far
    return changed


@kernel(parallel=True)
def evaluate_cells(tree, nodes, mesh, tolerance, per_area, ratios, reliefs):
    """Search cells for points off the terrain planes (exceptions), square by square.

    Parameters
    ----------
    nodes
        Indices of the cells (n,), which do not overlap.
    mesh
        Triangular mesh of terrain planes, as in `TerrainMesh.arrays`.
    tolerance
        Distance from the plane above which a point is an exception, m.
    per_area
        Minimum number of points per square metre in each quarter of a cell.
    ratios, reliefs
        Rasters of the squares, which receive two values. First, the fraction of exceptions among
        the points of a square. Second, the maximum distance of a point from the median plane of its
        cell, or of an exception from the mesh if that is larger, m. NaN where points are too few or
        there is no plane.

    Returns
    -------
    changed
        Which cells have a square whose value changed (n,).
    """
    changed = np.zeros(nodes.size, np.bool_)
    for i in prange(nodes.size):
        node = np.int64(
            nodes[i]
        )  # one integer type for all node arguments, so that functions compile once
        normal = np.empty(3)
        wide = ratios.shape[0] >> tree.depth[node]
        ratio, relief = np.zeros((wide, wide)), np.zeros((wide, wide))
        hx, hy = half_steps(tree, node)
        t = steepest_normal(hx, hy, mesh, normal) if is_evenly_sampled(tree, node, per_area) else -1
        if t < 0:
            ratio[:] = np.nan
            relief[:] = np.nan
        else:
            z = mesh_height(hx, hy, mesh, t, tree.half / (1 << tree.depths))
            x, y = cell_centre(tree, node)
            plane = (x, y, z, normal[0], normal[1], normal[2])
            _evaluate_cell(tree, node, plane, tolerance, ratio, relief)
        row0, col0 = np.int64(tree.row[node]) * wide, np.int64(tree.column[node]) * wide
        changed[i] = _write_squares(ratio, relief, row0, col0, ratios, reliefs)
    return changed


@kernel()
def blank_squares(outlines, square, ratios, reliefs):
    """Set the squares of the hazard rasters within given rectangles to NaN.

    `outlines` (n, 4) are west, east, south and north, and `square` is the side of a square, in half
    steps (half sides of the smallest cells). `ratios` and `reliefs` (rows, cols) are the rasters.

    Returns
    -------
    changed
        Which outlines contained a square that was not NaN (n,).
    """
    changed = np.zeros(outlines.shape[0], np.bool_)
    for i in range(outlines.shape[0]):
        for row in range(outlines[i, 2] // square, outlines[i, 3] // square):
            for col in range(outlines[i, 0] // square, outlines[i, 1] // square):
                changed[i] |= not np.isnan(ratios[row, col])
                ratios[row, col] = np.nan
                reliefs[row, col] = np.nan
    return changed
