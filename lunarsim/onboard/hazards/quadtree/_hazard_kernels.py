"""Compiled search for hazards: points that leave the ground planes (Eqs. 3 to 5).

A cell must be dense enough to be judged; exceptions are then told by squares a quarter of its side,
so that the top of a boulder is no small share of the points that it is counted among.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.onboard.hazards.quadtree._site_kernels import (
    evenly_seen,
    half_steps,
    mesh_height,
    steepest_normal,
)
from lunarsim.onboard.hazards.quadtree._tree_kernels import STACK, cell_centre

# Hazard cells divide into squares of 1 / 2^FINER of the side of the smallest.
FINER = 2
# Points that a square must be expected to hold for none to mean that it was not seen, and how many
# squares aside what lies there may tell that: no farther than the next of the smallest cells.
EXPECTED = 12
REACH = 1 << FINER


@kernel()
def _distances(tree, node, plane, wide, stack, off, square):
    """Write the distances (n,) of a cell's points to a plane, and in which squares they lie (n,).

    Points that stand apart are left out.

    Parameters
    ----------
    plane
        A point of it and its normal (6,).
    wide
        Squares along a side of the cell.

    Returns
    -------
    n
        Number of points.
    """
    x, y, z, a, b, c = plane
    reach = tree.half / (1 << tree.depth[node])
    mid_x, mid_y = cell_centre(tree, node)
    per_metre = wide / (2.0 * reach)
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
                if tree.apart[i]:
                    continue
                px, py = np.float64(tree.xyz[i, 0]), np.float64(tree.xyz[i, 1])
                off[n] = (px - x) * a + (py - y) * b + (tree.xyz[i, 2] - z) * c
                row = min(max(int((py - mid_y + reach) * per_metre), 0), wide - 1)
                col = min(max(int((px - mid_x + reach) * per_metre), 0), wide - 1)
                square[n] = row * wide + col
                n += 1
            run = tree.following[run]
    return n


@kernel()
def _count_exceptions(off, square, middle, tolerance, ratio, relief):
    """Write share of exceptions, and how far points reach, by the squares (w, w) of a cell.

    Distances (n,) are told from a plane and from the one parallel to it at a distance of `middle`.
    """
    wide = ratio.shape[0]
    number = np.zeros((wide, wide))
    for i in range(off.size):
        row, col = square[i] // wide, square[i] % wide
        number[row, col] += 1.0
        reach = abs(off[i] - middle)
        far = max(abs(off[i]), reach)
        if far > tolerance:
            ratio[row, col] += 1.0
            reach = far
        relief[row, col] = max(relief[row, col], reach)
    for row in range(wide):
        for col in range(wide):
            if number[row, col] > 0.0:
                ratio[row, col] /= number[row, col]


@kernel()
def _number_in(tree, depth, row, col):
    """Return how many points lie in a square of a depth (row and column from the south-west).

    A leaf larger than the square lends it its share. Nothing lies off the map.
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
def _seen_towards(tree, depth, row, col, up, right):
    """Return how many points lie in the next squares that way where some do; -1: none near.

    The greater number of two squares: half of the first may be hidden too.
    """
    for n in range(1, REACH + 1):
        number = _number_in(tree, depth, row + n * up, col + n * right)
        if number > 0.0:
            far = min(n + 1, REACH)
            return max(number, _number_in(tree, depth, row + far * up, col + far * right))
    return -1.0


@kernel()
def _expected(tree, depth, row, col):
    """Return how many points a square would hold, were it seen as what lies on two sides of it.

    What a scan covers has no bays: where its beams lie close on either side they do in between.
    Beside a scan, where only coarser ones came, they do not. Where nothing lies on the one side,
    what lies on the other must do; where nothing lies on any, no scan came there.
    """
    most = -1.0
    for up in range(2):
        ahead = _seen_towards(tree, depth, row, col, up, 1 - up)
        behind = _seen_towards(tree, depth, row, col, -up, up - 1)
        both = min(ahead, behind) if min(ahead, behind) >= 0.0 else max(ahead, behind)
        most = max(most, both)
    return most if most >= 0.0 else np.inf


@kernel()
def _clear_gaps(tree, node, ratio, relief):
    """Set squares (w, w) of a cell without a point to NaN where chance cannot have left them out.

    What was not seen may be what hides behind a boulder, or beyond the edge of a scan.
    """
    wide = ratio.shape[0]
    depth = np.int64(tree.depth[node])
    while (1 << (depth - tree.depth[node])) < wide:
        depth += 1
    row0, col0 = np.int64(tree.row[node]) * wide, np.int64(tree.column[node]) * wide
    for row in range(wide):
        for col in range(wide):
            # A leaf with points may have one anywhere.
            if _number_in(tree, depth, row0 + row, col0 + col) > 0.0:
                continue
            if _expected(tree, depth, row0 + row, col0 + col) >= EXPECTED:
                ratio[row, col] = np.nan
                relief[row, col] = np.nan


@kernel()
def _judge_cell(tree, node, plane, tolerance, ratio, relief):
    """Write share of exceptions, and how far points reach, by the squares (w, w) of a cell.

    A point is one if it is farther than `tolerance` from the mesh, or from the plane parallel to it
    in whose middle the cell's points lie: the floor of a crater agrees with the one, a boulder in
    a hollow with the other. The median is hardly higher for a boulder on less than half the cell.
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
    _clear_gaps(tree, node, ratio, relief)


@kernel(inline=True)
def _same(a, b):
    """Tell whether two numbers are equal, or both NaN."""
    return a == b or (np.isnan(a) and np.isnan(b))


@kernel()
def _paint(ratio, relief, row0, col0, ratios, reliefs):
    """Write the values of a cell's squares (w, w) into the rasters; tell whether one changed."""
    changed = False
    wide = ratio.shape[0]
    for row in range(wide):
        for col in range(wide):
            new, far = np.float32(ratio[row, col]), np.float32(relief[row, col])
            changed |= not _same(ratios[row0 + row, col0 + col], new)
            changed |= not _same(reliefs[row0 + row, col0 + col], far)
            ratios[row0 + row, col0 + col] = new
            reliefs[row0 + row, col0 + col] = far
    return changed


@kernel(parallel=True)
def judge_cells(tree, nodes, mesh, tolerance, per_area, ratios, reliefs):
    """Search cells for exceptions; write their squares into rasters over the whole map.

    Parameters
    ----------
    nodes
        Cells (n,), no two over the same ground.
    mesh
        Ground planes.
    tolerance
        Farthest that a point may lie from its plane, m.
    per_area
        Least number of points on a square metre of each quarter of a cell.
    ratios, reliefs
        Share of exceptions among a square's points, and how far one reaches at most from the middle
        of its cell's points, exceptions from the mesh if that is farther, m; NaN where points are
        too few or there is no plane.

    Returns
    -------
    changed
        Which cells have a square whose value changed (n,).
    """
    changed = np.zeros(nodes.size, np.bool_)
    for i in prange(nodes.size):
        node = np.int64(nodes[i])  # one type for all that take a node: compiled once
        normal = np.empty(3)
        wide = ratios.shape[0] >> tree.depth[node]
        ratio, relief = np.zeros((wide, wide)), np.zeros((wide, wide))
        hx, hy = half_steps(tree, node)
        t = steepest_normal(hx, hy, mesh, normal) if evenly_seen(tree, node, per_area) else -1
        if t < 0:
            ratio[:] = np.nan
            relief[:] = np.nan
        else:
            z = mesh_height(hx, hy, mesh, t, tree.half / (1 << tree.depths))
            x, y = cell_centre(tree, node)
            plane = (x, y, z, normal[0], normal[1], normal[2])
            _judge_cell(tree, node, plane, tolerance, ratio, relief)
        row0, col0 = np.int64(tree.row[node]) * wide, np.int64(tree.column[node]) * wide
        changed[i] = _paint(ratio, relief, row0, col0, ratios, reliefs)
    return changed


@kernel()
def clear(outlines, square, ratios, reliefs):
    """Set the squares (side: `square` half steps) within outlines (n, 4) to NaN.

    Returns
    -------
    changed
        Within which of them one was not (n,).
    """
    changed = np.zeros(outlines.shape[0], np.bool_)
    for i in range(outlines.shape[0]):
        for row in range(outlines[i, 2] // square, outlines[i, 3] // square):
            for col in range(outlines[i, 0] // square, outlines[i, 1] // square):
                changed[i] |= not np.isnan(ratios[row, col])
                ratios[row, col] = np.nan
                reliefs[row, col] = np.nan
    return changed
