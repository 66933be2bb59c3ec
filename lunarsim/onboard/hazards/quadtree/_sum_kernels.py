"""Compiled sums over the points of a quadtree's cells, and which points stand apart from them.

Sums are kept for nodes with children and for least cells with many points; a leaf without them has
few points to walk over. They leave out points that stand apart: a return off a bird or off nothing
lies farther in height from all others of its cell than ground and rocks can, and one at 1000 m
would lift the mean of hundreds. Which points these are depends on what the cell holds alone, not on
the order in which it came.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.hazards.quadtree._tree_kernels import cell_centre, with_room

# Sums over a node's points about its centre: x, y, z, xx, xy, xz, yy, yz, zz; their number, and
# their least and greatest z.
SUMS = 12
NUMBER, LOWEST, HIGHEST = 9, 10, 11
# Points from which a least cell has sums of its own.
MANY = 8
# A point stands apart if no other of its cell lies within so much in height: m, and m a metre of
# the cell's side. A cell of fewer points does not tell, nor one where more than a share does.
APART, APART_A_METRE = 0.3, 0.25
FEWEST, MOST_APART = 5, 0.25


@kernel(inline=True, inner=True)
def add_point(s, x, y, z):
    """Add a point, relative to the middle of sums, to them."""
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
    s[LOWEST] = min(s[LOWEST], z)
    s[HIGHEST] = max(s[HIGHEST], z)


@kernel(inline=True, inner=True)
def empty_sums(s):
    """Set sums to those of no point."""
    for k in range(LOWEST):
        s[k] = 0.0
    s[LOWEST] = np.inf
    s[HIGHEST] = -np.inf


@kernel(inline=True, inner=True)
def add_shifted(out, s, dx, dy):
    """Add sums s to `out`, about a point that lies (-dx, -dy) from theirs."""
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
    out[LOWEST] = min(out[LOWEST], s[LOWEST])
    out[HIGHEST] = max(out[HIGHEST], s[HIGHEST])


@kernel(inner=True)
def add_leaf(tree, leaf, cx, cy, out):
    """Add the points of a leaf that do not stand apart to sums about (cx, cy)."""
    run = tree.head[leaf]
    while run >= 0:
        begin = tree.start[run]
        for i in range(begin, begin + tree.length[run]):
            if not tree.apart[i]:
                x, y = np.float64(tree.xyz[i, 0]) - cx, np.float64(tree.xyz[i, 1]) - cy
                add_point(out, x, y, np.float64(tree.xyz[i, 2]))
        run = tree.following[run]


@kernel(inner=True)
def sums_of(tree, node, out):
    """Write the sums of a node about its centre."""
    if tree.slot[node] >= 0:
        out[:] = tree.sums[tree.slot[node]]
        return
    empty_sums(out)
    cx, cy = cell_centre(tree, node)
    add_leaf(tree, node, cx, cy, out)


@kernel()
def moments(tree, nodes):
    """Return number, mean and variance of the heights (n, 3) of cells; NaN without points."""
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
    """Return how far in height from all others of a cell a point stands apart, m."""
    return APART + APART_A_METRE * 2.0 * tree.half / (1 << tree.depth[node])


@kernel()
def _loose(tree, node, found):
    """List the points of a cell that no sums below it hold; return the list and their number.

    The points of a leaf, or of the leaves among a node's children that have no sums.
    """
    n = np.int64(0)  # a plain zero is a type of its own
    own = tree.child[node] < 0
    for q in range(1 if own else 4):
        leaf = node if own else tree.child[node] + q
        if not own and tree.slot[leaf] >= 0:
            continue
        run = tree.head[leaf]
        while run >= 0:
            begin = tree.start[run]
            for i in range(begin, begin + tree.length[run]):
                found = with_room(found, n)
                found[n] = i
                n += 1
            run = tree.following[run]
    return found, n


@kernel()
def _part_apart(tree, node, index, tolerance):
    """Say which of a cell's loose points stand apart from all its others."""
    held = 0.0
    if tree.child[node] >= 0:
        for q in range(4):
            slot = tree.slot[tree.child[node] + q]
            held += tree.sums[slot, NUMBER] if slot >= 0 else 0.0
    order = np.argsort(tree.xyz[index, 2])
    apart = 0
    for j in range(index.size):
        z = np.float64(tree.xyz[index[order[j]], 2])
        alone = (j == 0 or z - tree.xyz[index[order[j - 1]], 2] > tolerance) and (
            j == index.size - 1 or tree.xyz[index[order[j + 1]], 2] - z > tolerance
        )
        if alone and held > 0.0:
            for q in range(4):
                slot = tree.slot[tree.child[node] + q]
                if slot >= 0 and tree.sums[slot, NUMBER] > 0.0:
                    alone &= (
                        z < tree.sums[slot, LOWEST] - tolerance
                        or z > tree.sums[slot, HIGHEST] + tolerance
                    )
        tree.apart[index[order[j]]] = alone
        apart += alone
    total = held + index.size
    if total < FEWEST or apart > MOST_APART * total:
        tree.apart[index] = False


@kernel(inner=True)
def settle(tree, node, found):
    """Find which points of a touched cell stand apart, and its sums, afresh; return the list.

    A cell with children that have sums of their own takes those.
    """
    found, n = _loose(tree, node, found)
    low, high = np.inf, -np.inf
    some = False
    for j in range(n):
        z = np.float64(tree.xyz[found[j], 2])
        low, high = min(low, z), max(high, z)
        some |= tree.apart[found[j]]
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
    wide = n > 0 and max(high, s[HIGHEST]) - min(low, s[LOWEST]) > tolerance
    if some or wide:
        before = tree.apart[found[:n]]
        tree.apart[found[:n]] = False
        if wide:
            _part_apart(tree, node, found[:n], tolerance)
        if tree.child[node] >= 0 and (before != tree.apart[found[:n]]).any():
            # What these leaves tell has changed, wherever the new points lie.
            for q in range(4):
                tree.stamp[tree.child[node] + q] = tree.stamp[node]
    cx, cy = cell_centre(tree, node)
    for j in range(n):
        i = found[j]
        if not tree.apart[i]:
            x, y = np.float64(tree.xyz[i, 0]) - cx, np.float64(tree.xyz[i, 1]) - cy
            add_point(s, x, y, np.float64(tree.xyz[i, 2]))
    tree.sums[tree.slot[node]] = s
    return found


@kernel(inner=True)
def add_to_many(tree, leaf, first, last, found):
    """Add the points from `first` to `last` to a least cell that has sums; return `found`.

    Where they could change which points stand apart all of the cell is settled afresh.
    """
    s = tree.sums[tree.slot[leaf]]
    tolerance = _tolerance(tree, leaf)
    low, high = s[LOWEST], s[HIGHEST]
    plain = high - low <= tolerance
    none_apart = s[NUMBER] == tree.count[leaf] - (last - first)
    for i in range(first, last):
        z = np.float64(tree.xyz[i, 2])
        if none_apart and min(abs(z - low), abs(z - high)) <= tolerance:
            low, high = min(low, z), max(high, z)
        elif not (plain and low <= z <= high):
            return settle(tree, leaf, found)
    cx, cy = cell_centre(tree, leaf)
    for i in range(first, last):
        x, y = np.float64(tree.xyz[i, 0]) - cx, np.float64(tree.xyz[i, 1]) - cy
        tree.apart[i] = False
        add_point(s, x, y, np.float64(tree.xyz[i, 2]))
    return found


@kernel()
def count_in_squares(xyz, half, side, count):
    """Add to `count` (n, n) how many points fall into each square of a map about (0, 0).

    The map reaches to `half` each way; what lies beyond it, by rounding, counts at its edge.
    """
    last = count.shape[0] - 1
    for k in range(xyz.shape[0]):
        col = min(max(np.int64((xyz[k, 0] + half) / side), 0), last)
        row = min(max(np.int64((xyz[k, 1] + half) / side), 0), last)
        count[row, col] += 1
