# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled sums over the points of quadtree cells, and outliers in height.

Sums are stored for nodes with children and for smallest cells with many points. Other leaves have
few points, which are summed on demand. The sums exclude outliers: a spurious return or one from a
bird is farther in height from all other points of its cell than terrain and rocks can be, and one
at 1000 m would raise the mean of hundreds. The outliers depend only on the points of a cell, not on
the order in which they came.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.hazards.quadtree._tree_kernels import cell_centre, with_capacity

# Sums over the points of a node relative to its centre: x, y, z, xx, xy, xz, yy, yz, zz; then their
# number, and the minimum and maximum z.
SUMS = 12
NUMBER, MIN_Z, MAX_Z = 9, 10, 11
# Minimum number of points for a smallest cell to have separate sums.
MIN_POINTS_FOR_SUMS = 8
# A point is an outlier if no other point of its cell is within this height: m, plus m per metre of
# the cell side. A cell with fewer points, or with a larger share of outliers, has none.
OUTLIER_GAP_M, OUTLIER_GAP_PER_M = 0.3, 0.25
MIN_POINTS_FOR_OUTLIERS, MAX_OUTLIER_SHARE = 5, 0.25


@kernel(inline=True, inner=True)
def add_point(s, x, y, z):
    """Add a point to the moment sums of a cell.

    `s` (12,) are the sums of x, y, z and their products, the number of points, and minimum and
    maximum z. `x`, `y`, `z` are the coordinates of the point relative to the centre of the sums, m.
    """
    s[0] += x
    s[1] += y
    s[2] += z
    s[3] += x * x
    s[4] += x * y
    s[5] += x * z
    s[6] += y * y
    s[7] += y * z
    s[8] += z * z
    s[NUMBER] += 1.0
    s[MIN_Z] = min(s[MIN_Z], z)
    s[MAX_Z] = max(s[MAX_Z], z)


@kernel(inline=True, inner=True)
def empty_sums(s):
    """Set the moment sums `s` (12,) of a cell to the values for no points."""
    for k in range(MIN_Z):
        s[k] = 0.0
    s[MIN_Z] = np.inf
    s[MAX_Z] = -np.inf


@kernel(inline=True, inner=True)
def add_shifted(out, s, dx, dy):
    """Add moment sums about one centre to sums about another centre.

    `s` (12,) is added to `out` (12,). (`dx`, `dy`) is the centre of `s` relative to that of `out`,
    m.
    """
    n = s[NUMBER]
    out[0] += s[0] + n * dx
    out[1] += s[1] + n * dy
    out[2] += s[2]
    out[3] += s[3] + 2.0 * dx * s[0] + n * dx * dx
    out[4] += s[4] + dx * s[1] + dy * s[0] + n * dx * dy
    out[5] += s[5] + dx * s[2]
    out[6] += s[6] + 2.0 * dy * s[1] + n * dy * dy
    out[7] += s[7] + dy * s[2]
    out[8] += s[8]
    out[NUMBER] += n
    out[MIN_Z] = min(out[MIN_Z], s[MIN_Z])
    out[MAX_Z] = max(out[MAX_Z], s[MAX_Z])


@kernel(inner=True)
def add_leaf(tree, leaf, cx, cy, out):
    """Add the points of a leaf, without outliers, to moment sums about (cx, cy).

    `leaf` is the index of the cell, (`cx`, `cy`) is in m, and `out` (12,) are the sums.
    """
    run = tree.head[leaf]
    while run >= 0:
        begin = tree.start[run]
        for i in range(begin, begin + tree.length[run]):
            if not tree.is_outlier[i]:
                x, y = np.float64(tree.xyz[i, 0]) - cx, np.float64(tree.xyz[i, 1]) - cy
                add_point(out, x, y, np.float64(tree.xyz[i, 2]))
        run = tree.following[run]


@kernel(inner=True)
def sums_of(tree, node, out):
    """Write the moment sums of a cell about its centre into `out` (12,).

    `node` is the index of the cell. Stored sums are used if they exist.
    """
    if tree.slot[node] >= 0:
        out[:] = tree.sums[tree.slot[node]]
        return
    empty_sums(out)
    cx, cy = cell_centre(tree, node)
    add_leaf(tree, node, cx, cy, out)


@kernel()
def moments(tree, nodes):
    """Return number, mean and variance of the heights in cells (n, 3), m and m^2.

    `nodes` (n,) are the indices of the cells. Mean and variance are NaN without points.
    """
    out = np.empty((nodes.size, 3))
    s = np.empty(SUMS)
    for i in range(nodes.size):
        sums_of(tree, nodes[i], s)
        mean = s[2] / s[NUMBER]
        out[i, 0] = s[NUMBER]
        out[i, 1] = mean
        out[i, 2] = max(s[8] / s[NUMBER] - mean * mean, 0.0) if s[NUMBER] > 0.0 else np.nan
    return out


@kernel(inline=True)
def _tolerance(tree, node):
    """Return the height gap, m, beyond which a point of a cell is an outlier.

    The gap is measured to the nearest other point of the cell and grows with the cell size.
    """
    return OUTLIER_GAP_M + OUTLIER_GAP_PER_M * 2.0 * tree.half / (1 << tree.depth[node])


@kernel()
def _unsummed_points(tree, node, index_buffer):
    """List the points of a cell that are not contained in the sums of its children.

    These are the points of a leaf, or of those children of a node that have no sums. The indices
    are written to `index_buffer`. Returns this array, possibly enlarged, and the number of points.
    """
    n = np.int64(0)  # a typed zero, so that functions compile once
    own = tree.child[node] < 0
    for q in range(1 if own else 4):
        leaf = node if own else tree.child[node] + q
        if not own and tree.slot[leaf] >= 0:
            continue
        run = tree.head[leaf]
        while run >= 0:
            begin = tree.start[run]
            for i in range(begin, begin + tree.length[run]):
                index_buffer = with_capacity(index_buffer, n)
                index_buffer[n] = i
                n += 1
            run = tree.following[run]
    return index_buffer, n


@kernel()
def _mark_outliers(tree, node, index, tolerance):
    """Mark as outliers the points of a cell that are isolated in height.

    `index` (n,) are the points of cell `node` that are not in the sums of its children. A point is
    isolated if no other point is within `tolerance`, m. If the outliers are too many or the points
    too few, none is marked.
    """
    summed_count = 0.0
    if tree.child[node] >= 0:
        for q in range(4):
            slot = tree.slot[tree.child[node] + q]
            summed_count += tree.sums[slot, NUMBER] if slot >= 0 else 0.0
    order = np.argsort(tree.xyz[index, 2])
    outlier_count = 0
    for j in range(index.size):
        z = np.float64(tree.xyz[index[order[j]], 2])
        is_isolated = (j == 0 or z - tree.xyz[index[order[j - 1]], 2] > tolerance) and (
            j == index.size - 1 or tree.xyz[index[order[j + 1]], 2] - z > tolerance
        )
        if is_isolated and summed_count > 0.0:
            for q in range(4):
                slot = tree.slot[tree.child[node] + q]
                if slot >= 0 and tree.sums[slot, NUMBER] > 0.0:
                    is_isolated &= (
                        z < tree.sums[slot, MIN_Z] - tolerance
                        or z > tree.sums[slot, MAX_Z] + tolerance
                    )
        tree.is_outlier[index[order[j]]] = is_isolated
        outlier_count += is_isolated
    total = summed_count + index.size
    if total < MIN_POINTS_FOR_OUTLIERS or outlier_count > MAX_OUTLIER_SHARE * total:
        tree.is_outlier[index] = False


@kernel(inner=True)
def update_outliers_and_sums(tree, node, index_buffer):
    """Recompute the outliers in height and the stored moment sums of one cell.

    Children with stored sums contribute these sums, and their points are not tested again. `tree`
    is updated. `index_buffer` is a work array, which is returned, possibly enlarged.
    """
    index_buffer, n = _unsummed_points(tree, node, index_buffer)
    low, high = np.inf, -np.inf
    some = False
    for j in range(n):
        z = np.float64(tree.xyz[index_buffer[j], 2])
        low, high = min(low, z), max(high, z)
        some |= tree.is_outlier[index_buffer[j]]
    s = np.empty(SUMS)
    empty_sums(s)
    if tree.child[node] >= 0:
        quarter = 0.5 * tree.half / (1 << tree.depth[node])
        for q in range(4):
            slot = tree.slot[tree.child[node] + q]
            if slot >= 0:
                dx = quarter if q & 1 else -quarter
                dy = quarter if q & 2 else -quarter
                add_shifted(s, tree.sums[slot], dx, dy)
    tolerance = _tolerance(tree, node)
    wide = n > 0 and max(high, s[MAX_Z]) - min(low, s[MIN_Z]) > tolerance
    if some or wide:
        before = tree.is_outlier[index_buffer[:n]]
        tree.is_outlier[index_buffer[:n]] = False
        if wide:
            _mark_outliers(tree, node, index_buffer[:n], tolerance)
        if tree.child[node] >= 0 and (before != tree.is_outlier[index_buffer[:n]]).any():
            # The result of these leaves has changed, wherever the new points are.
            for q in range(4):
                tree.stamp[tree.child[node] + q] = tree.stamp[node]
    cx, cy = cell_centre(tree, node)
    for j in range(n):
        i = index_buffer[j]
        if not tree.is_outlier[i]:
            x, y = np.float64(tree.xyz[i, 0]) - cx, np.float64(tree.xyz[i, 1]) - cy
            add_point(s, x, y, np.float64(tree.xyz[i, 2]))
    tree.sums[tree.slot[node]] = s
    return index_buffer


@kernel(inner=True)
def add_to_summed_cell(tree, leaf, first, last, index_buffer):
    """Add points `first` to `last` (excluded) to a smallest cell that has moment sums.

    If the points could change which points are outliers, the complete cell is recomputed.
    `index_buffer` is a work array, which is returned, possibly enlarged.
    """
    s = tree.sums[tree.slot[leaf]]
    tolerance = _tolerance(tree, leaf)
    low, high = s[MIN_Z], s[MAX_Z]
    plain = high - low <= tolerance
    # More isolated points than may be marked would need this range of heights.
    isolated_range = np.floor(MAX_OUTLIER_SHARE * s[NUMBER]) * tolerance
    none_apart = s[NUMBER] == tree.count[leaf] - (last - first) and high - low <= isolated_range
    for i in range(first, last):
        z = np.float64(tree.xyz[i, 2])
        if none_apart and min(abs(z - low), abs(z - high)) <= tolerance:
            low, high = min(low, z), max(high, z)
        elif not (plain and low <= z <= high):
            return update_outliers_and_sums(tree, leaf, index_buffer)
    cx, cy = cell_centre(tree, leaf)
    for i in range(first, last):
        x, y = np.float64(tree.xyz[i, 0]) - cx, np.float64(tree.xyz[i, 1]) - cy
        tree.is_outlier[i] = False
        add_point(s, x, y, np.float64(tree.xyz[i, 2]))
    return index_buffer


@kernel()
def count_in_squares(xyz, half, side, count):
    """Count the points in each square of a map and add them to `count` (n, n).

    `xyz` (m, 3) are relative to the centre of the map, m. `half` is half the side of the map and
    `side` the side of a square, m. Points beyond the map, due to rounding, count at its edge.
    """
    last = count.shape[0] - 1
    for k in range(xyz.shape[0]):
        col = min(max(np.int64((xyz[k, 0] + half) / side), 0), last)
        row = min(max(np.int64((xyz[k, 1] + half) / side), 0), last)
        count[row, col] += 1
