# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled insertion of sorted batches of points into a quadtree.

Splitting a leaf divides its runs of points and moves no point.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.hazards.quadtree._sum_kernels import (
    MIN_POINTS_FOR_SUMS,
    add_to_summed_cell,
    update_outliers_and_sums,
)
from lunarsim.onboard.hazards.quadtree._tree_kernels import STACK, cell_centre

RADIX_BITS = 11  # bits per pass of the radix sort


@kernel(inline=True)
def _spread_bits(v):
    """Insert a zero bit between the 16 bits of `v`, to interleave two coordinates."""
    v = (v | (v << 8)) & 0x00FF00FF
    v = (v | (v << 4)) & 0x0F0F0F0F
    v = (v | (v << 2)) & 0x33333333
    return (v | (v << 1)) & 0x55555555


@kernel(inline=True)
def _column_of(coordinate, half, per_metre):
    """Return the column (or row) of smallest cells that contains a coordinate.

    `half` is half the side of the map, m, and `per_metre` the number of cells per metre.
    """
    return np.int64(np.floor((np.float64(coordinate) + half) * per_metre))


@kernel()
def _radix_argsort(key, bits):
    """Return the indices (n,) that sort integer keys (stable radix sort).

    `key` (n,) has `bits` significant bits.
    """
    n = key.size
    order = np.arange(n).astype(np.int32)
    spare = np.empty(n, np.int32)
    mask = (1 << RADIX_BITS) - 1
    shift = 0
    while shift < bits:
        begin = np.zeros((1 << RADIX_BITS) + 1, np.int64)
        for i in range(n):
            begin[((key[i] >> shift) & mask) + 1] += 1
        for d in range(1 << RADIX_BITS):
            begin[d + 1] += begin[d]
        for i in range(n):
            d = (key[order[i]] >> shift) & mask
            spare[begin[d]] = order[i]
            begin[d] += 1
        order, spare = spare, order
        shift += RADIX_BITS
    return order


@kernel()
def sort_points(points, centre, half, max_depth, max_height):
    """Sort points (n, 3) along the Z-order curve of the smallest cells.

    `centre` (3,) and `half` are centre and half side of the map, m. `max_depth` is the depth of the
    smallest cells, and `max_height` the maximum height above or below the centre, m. Returns the
    points on the map (m, 3), relative to its centre, m, and their Z-order keys (m,). Three numbers
    of rejected points follow: off the map, with NaN, and on the map but beyond `max_height`.
    """
    n = points.shape[0]
    side = 1 << max_depth
    per_metre = side / (2.0 * half)
    key = np.empty(n, np.uint32)
    kept = np.empty((n, 3), np.float32)
    high = 0
    m = 0
    outside = 0
    missing = 0
    for i in range(n):
        x = np.float32(points[i, 0] - centre[0])
        y = np.float32(points[i, 1] - centre[1])
        z = np.float32(points[i, 2] - centre[2])
        if np.isnan(x) or np.isnan(y) or np.isnan(z):
            missing += 1
            continue
        if not (-half <= x < half and -half <= y < half):
            outside += 1
            continue
        column = _column_of(x, half, per_metre)
        row = _column_of(y, half, per_metre)
        if column >= side or row >= side:
            outside += 1
            continue
        if abs(z) > max_height:
            high += 1
            continue
        kept[m, 0] = x
        kept[m, 1] = y
        kept[m, 2] = z
        key[m] = _spread_bits(column) | (_spread_bits(row) << 1)
        m += 1
    order = _radix_argsort(key[:m], 2 * max_depth)
    xyz = np.empty((m, 3), np.float32)
    sorted_key = np.empty(m, np.uint32)
    for i in range(m):
        j = order[i]
        xyz[i, 0] = kept[j, 0]
        xyz[i, 1] = kept[j, 1]
        xyz[i, 2] = kept[j, 2]
        sorted_key[i] = key[j]
    return xyz, sorted_key, outside, missing, high


@kernel()
def _split(tree, node, used, version):
    """Split a leaf into four children and divide its points among them.

    `node` is the index of the leaf. Its points are stored as runs, sections of the list of all
    points. `used` is the number of nodes, runs and sums in use; the function returns their new
    numbers. `version` is the number of the current batch.
    """
    nodes, runs, slots = used
    first = nodes
    depth = tree.depth[node] + 1
    for q in range(4):
        c = first + q
        tree.child[c] = -1
        tree.depth[c] = depth
        tree.column[c] = 2 * tree.column[node] + (q & 1)
        tree.row[c] = 2 * tree.row[node] + (q >> 1)
        tree.count[c] = 0
        tree.stamp[c] = version
        tree.head[c] = -1
        tree.slot[c] = -1
    tree.child[node] = first
    tree.slot[node] = slots
    mid_x, mid_y = cell_centre(tree, node)
    run = tree.head[node]
    while run >= 0:
        after = tree.following[run]
        begin = tree.start[run]
        end = begin + tree.length[run]
        reuse = True
        i = begin
        while i < end:
            q = (1 if tree.xyz[i, 0] >= mid_x else 0) + (2 if tree.xyz[i, 1] >= mid_y else 0)
            # The run is sorted: the quadrant ends where the next one begins.
            low, high = i + 1, end
            while low < high:
                m = (low + high) // 2
                other = (1 if tree.xyz[m, 0] >= mid_x else 0) + (
                    2 if tree.xyz[m, 1] >= mid_y else 0
                )
                if other == q:
                    low = m + 1
                else:
                    high = m
            if reuse:
                piece = run
                reuse = False
            else:
                piece = runs
                runs += 1
            tree.start[piece] = i
            tree.length[piece] = low - i
            tree.following[piece] = tree.head[first + q]
            tree.head[first + q] = piece
            tree.count[first + q] += low - i
            i = low
        run = after
    tree.head[node] = -1
    return nodes + 4, runs, slots + 1


@kernel(inline=True)
def _child_towards(tree, node, depth, key):
    """Return the child of a node at `depth` whose cell contains a Z-order key."""
    return tree.child[node] + ((key >> (2 * (tree.depths - depth - 1))) & 3)


@kernel(inline=True)
def _leaf_of(tree, key):
    """Return the leaf whose cell contains a Z-order key, and the depth of the leaf."""
    node = 0
    depth = 0
    while tree.child[node] >= 0:
        node = _child_towards(tree, node, depth, key)
        depth += 1
    return node, depth


@kernel(inline=True)
def _end_of_cell(key, i, shift):
    """Return the first index after `i` whose key is outside the cell of key[i].

    `key` (n,) are sorted Z-order keys. The keys in a cell have the same leading bits: all but the
    last `shift`. The result is n if all further keys are in the cell.
    """
    prefix = key[i] >> shift
    j = i + 1
    while j < key.size and key[j] >> shift == prefix:
        j += 1
    return j


@kernel(inline=True)
def _count_along_path(tree, leaf, key, added, version, touched, count):
    """Add `added` points to the counts of a leaf and its ancestors.

    `key` is a Z-order key in the leaf. Cells that the batch `version` has not reached before are
    appended to `touched`, which has `count` entries. Returns the new number of entries.
    """
    node = 0
    depth = 0
    while True:
        if tree.stamp[node] != version:
            tree.stamp[node] = version
            touched[count] = node
            count += 1
        tree.count[node] += added
        if node == leaf:
            return count
        node = _child_towards(tree, node, depth, key)
        depth += 1


@kernel()
def _split_if_needed(tree, leaf, run, split_count, used, version, touched, count, index_buffer):
    """Split a leaf that has too many points, and update the sums of smallest cells.

    Children with too many points are split too. Moment sums are computed only for cells of the
    smallest size; those of split cells are left to the caller.

    `run` is the new run of points in `leaf`, and `split_count` the number of points at which a cell
    splits. `used` is the number of nodes, runs and sums in use, `version` the number of the batch.
    `touched` lists the cells that the batch has reached, with `count` entries; split cells are
    appended. `index_buffer` is a work array.

    Returns nodes, runs and sums in use, the number of cells in `touched`, and the work array,
    possibly enlarged.
    """
    nodes, runs, slots = used
    depths = tree.depths
    first, more = tree.start[run], tree.length[run]
    if tree.depth[leaf] == depths and tree.slot[leaf] >= 0:
        return used, count, add_to_summed_cell(tree, leaf, first, first + more, index_buffer)
    stack = np.empty(STACK, np.int32)
    stack[0] = leaf
    top = 1
    while top > 0:
        top -= 1
        m = np.int64(
            stack[top]
        )  # one integer type for all node arguments, so that functions compile once
        if tree.depth[m] == depths:
            if tree.count[m] >= MIN_POINTS_FOR_SUMS:
                tree.slot[m] = slots
                slots += 1
                index_buffer = update_outliers_and_sums(tree, m, index_buffer)
            continue
        if tree.count[m] < split_count:
            continue
        nodes, runs, slots = _split(tree, m, (nodes, runs, slots), version)
        if m != leaf:
            touched[count] = m
            count += 1
        for q in range(4):
            stack[top] = tree.child[m] + q
            top += 1
    return (nodes, runs, slots), count, index_buffer


@kernel()
def insert(tree, key, base, begin, used, split_count, version):
    """Insert a sorted batch of points, stored from index `base`, into the quadtree.

    The function continues at point `begin` of the batch and stops when all points are inserted or
    an array of the tree might be too small. `key` (n,) are the Z-order keys of the batch. `used` is
    the number of nodes, runs and sums in use. `split_count` is the number of points at which a cell
    splits, and `version` the number of the batch.

    Returns the index of the first point that was not inserted, and the numbers of nodes, runs and
    sums in use.
    """
    nodes, runs, slots = used
    touched = np.empty(tree.child.size, np.int32)
    count = 0
    index_buffer = np.empty(256, np.int64)
    depths = tree.depths
    i = begin
    while i < key.size:
        leaf, depth = _leaf_of(tree, key[i])
        j = _end_of_cell(key, i, 2 * (depths - depth))
        # Per deeper level at most total / split_count cells split; each divided run has a point.
        total = tree.count[leaf] + (j - i)
        divided = (depths - depth) * (total // split_count)
        if (
            nodes + 4 * divided >= tree.child.size
            or runs + total + 1 >= tree.start.size
            or slots + divided + total // MIN_POINTS_FOR_SUMS >= tree.sums.shape[0]
        ):
            break
        count = _count_along_path(tree, leaf, key[i], j - i, version, touched, count)
        tree.start[runs] = base + i
        tree.length[runs] = j - i
        tree.following[runs] = tree.head[leaf]
        tree.head[leaf] = runs
        tree.is_outlier[base + i : base + j] = False
        (nodes, runs, slots), count, index_buffer = _split_if_needed(
            tree,
            leaf,
            runs,
            split_count,
            (nodes, runs + 1, slots),
            version,
            touched,
            count,
            index_buffer,
        )
        i = j
    # A child is always touched after its parent.
    for t in range(count - 1, -1, -1):
        if tree.child[touched[t]] >= 0:
            index_buffer = update_outliers_and_sums(tree, np.int64(touched[t]), index_buffer)
    return i, nodes, runs, slots
