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
    """Write the distances (n,) of a cell's points to a plane, and their squares (n,).

    Outliers in height are omitted. `plane` is a point and a normal (6,); `squares` is the number of
    squares along a side of the cell. Returns the number of points.
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
    """Write share of exceptions and maximum distance per square (w, w) of a cell.

    Distances (n,) are measured from a plane and from its parallel at distance `middle`.
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
    """Return the number of points in a square of a depth; 0 off the map.

    Row and column are counted from the south-west. A leaf larger than the square contributes its
    share.
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
    """Return the points in the next occupied squares in a direction; -1 if none.

    The larger number of two squares, because half of the first may be hidden too.
    """
    for n in range(1, NEIGHBOUR_SQUARES + 1):
        number = _count_in_square(tree, depth, row + n * up, col + n * right)
        if number > 0.0:
            far = min(n + 1, NEIGHBOUR_SQUARES)
            return max(number, _count_in_square(tree, depth, row + far * up, col + far * right))
    return -1.0


@kernel()
def _expected_count(tree, depth, row, col):
    """Return the expected number of points in a square from its neighbours.

    The coverage of a scan has no concave edges: between two observed squares the density is the
    same. Next to a scan, only coarser scans may have measured. With one occupied side, that side is
    used; without any, no scan covers the square and the result is inf.
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
    """Set empty squares (w, w) of a cell to NaN if chance does not explain them.

    An unobserved square may be hidden behind a boulder or lie beyond the edge of a scan.
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
    """Write share of exceptions and maximum distance per square (w, w) of a cell.

    A point is an exception if it is farther than `tolerance` from the mesh, or from the parallel
    plane at the median of the points of the cell. The floor of a crater agrees with the latter, a
    boulder in a hollow with the former. A boulder on less than half the cell hardly raises the
    median.
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
    """Write the squares (w, w) of a cell into the rasters; return whether one changed."""
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
    """Search cells for exceptions and write their squares into rasters of the map.

    Parameters
    ----------
    nodes
        Cells (n,) that do not overlap.
    mesh
        Terrain planes.
    tolerance
        Distance from the plane above which a point is an exception, m.
    per_area
        Minimum number of points per square metre in each quarter of a cell.
    ratios, reliefs
        Share of exceptions among the points of a square, and maximum distance of a point from the
        median plane of its cell, or of an exception from the mesh if that is larger, m. NaN where
        points are too few or there is no plane.

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
    """Set the squares (side: `square` half steps) within outlines (n, 4) to NaN.

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
