"""Compiled quadtree: insertion of sorted batches, and queries.

Nodes live in parallel arrays; the four children of a node are consecutive, so one index finds them,
and a parent's index is always below its children's. A leaf owns its points as a chain of runs:
stretches of the pool, where every batch lies sorted along the Z-order curve. Splitting a leaf cuts
its runs and moves no point.

Quadrant q of a node lies east if q & 1 and north if q & 2.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lunarsim._jit import kernel

DIGIT = 11  # bits a pass of the radix sort
# Sums over a node's points about its centre: x, y, z, xx, xy, xz, yy, yz, zz.
SUMS = 9
# Deepest walk: three siblings wait at each of at most 16 levels.
STACK = 64


class Tree(NamedTuple):
    """What kernels need of a quadtree."""

    half: float  # half the root's side, m
    depths: int  # depth of the least cells
    xyz: Any  # points (n, 3) relative to the root's centre, float32
    child: Any  # first child, -1 for a leaf (N,)
    depth: Any  # (N,)
    column: Any  # of the cell among those of its depth, from the west (N,)
    row: Any  # from the south (N,)
    count: Any  # points (N,)
    sums: Any  # (N, 9)
    stamp: Any  # number of the last batch that added points (N,)
    head: Any  # first run, -1 for none (N,)
    start: Any  # of runs, in the pool
    length: Any
    following: Any  # next run, -1 for the last


@kernel(inline=True)
def _spread(v):
    """Put a zero bit between the 16 bits of v."""
    v = (v | (v << 8)) & 0x00FF00FF
    v = (v | (v << 4)) & 0x0F0F0F0F
    v = (v | (v << 2)) & 0x33333333
    return (v | (v << 1)) & 0x55555555


@kernel(inline=True)
def _column_of(v, half, per_metre):
    """Return the column (or row) of least cells that holds the coordinate v."""
    return np.int64(np.floor((np.float64(v) + half) * per_metre))


@kernel()
def with_room(array, n):
    """Return a list of which n entries are taken, enlarged if there is no room for another."""
    if n < array.size:
        return array
    grown = np.empty(2 * n + 64, array.dtype)
    grown[:n] = array
    return grown


@kernel()
def _order_of(key, bits):
    """Return the order (n,) that sorts keys of so many bits (radix sort, stable)."""
    n = key.size
    order = np.arange(n)
    spare = np.empty(n, np.int64)
    mask = (1 << DIGIT) - 1
    shift = 0
    while shift < bits:
        begin = np.zeros((1 << DIGIT) + 1, np.int64)
        for i in range(n):
            begin[((key[i] >> shift) & mask) + 1] += 1
        for d in range(1 << DIGIT):
            begin[d + 1] += begin[d]
        for i in range(n):
            d = (key[order[i]] >> shift) & mask
            spare[begin[d]] = order[i]
            begin[d] += 1
        order, spare = spare, order
        shift += DIGIT
    return order


@kernel()
def place(points, centre, half, depths):
    """Sort points (n, 3) along the Z-order curve of the least cells.

    Returns
    -------
    xyz, key
        Of the points on the map (m, 3) and (m,), relative to its centre.
    outside, missing
        How many lie outside and how many are no numbers.
    """
    n = points.shape[0]
    side = 1 << depths
    per_metre = side / (2.0 * half)
    key = np.empty(n, np.int64)
    kept = np.empty((n, 3), np.float32)
    m = 0
    outside = 0
    missing = 0
    for i in range(n):
        x = np.float32(points[i, 0] - centre[0])
        y = np.float32(points[i, 1] - centre[1])
        z = np.float32(points[i, 2] - centre[2])
        if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
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
        kept[m, 0] = x
        kept[m, 1] = y
        kept[m, 2] = z
        key[m] = _spread(column) | (_spread(row) << 1)
        m += 1
    order = _order_of(key[:m], 2 * depths)
    xyz = np.empty((m, 3), np.float32)
    sorted_key = np.empty(m, np.int64)
    for i in range(m):
        j = order[i]
        xyz[i, 0] = kept[j, 0]
        xyz[i, 1] = kept[j, 1]
        xyz[i, 2] = kept[j, 2]
        sorted_key[i] = key[j]
    return xyz, sorted_key, outside, missing


@kernel(inline=True)
def cell_centre(tree, node):
    """Return the centre of a node, relative to the root's."""
    size = 2.0 * tree.half / (1 << tree.depth[node])
    return (
        (tree.column[node] + 0.5) * size - tree.half,
        (tree.row[node] + 0.5) * size - tree.half,
    )


@kernel()
def _add_to_sums(tree, node, first, last):
    """Add the points of the pool from `first` to `last` (not included) to a node's sums."""
    cx, cy = cell_centre(tree, node)
    s = np.zeros(SUMS)
    for i in range(first, last):
        x = tree.xyz[i, 0] - cx
        y = tree.xyz[i, 1] - cy
        z = np.float64(tree.xyz[i, 2])
        s[0] += x
        s[1] += y
        s[2] += z
        s[3] += x * x
        s[4] += x * y
        s[5] += x * z
        s[6] += y * y
        s[7] += y * z
        s[8] += z * z
    for k in range(SUMS):
        tree.sums[node, k] += s[k]


@kernel(inline=True)
def add_shifted(out, s, n, dx, dy):
    """Add sums s over n points to `out`, about a point that lies (-dx, -dy) from theirs."""
    out[0] += s[0] + n * dx
    out[1] += s[1] + n * dy
    out[2] += s[2]
    out[3] += s[3] + 2.0 * dx * s[0] + n * dx * dx
    out[4] += s[4] + dx * s[1] + dy * s[0] + n * dx * dy
    out[5] += s[5] + dx * s[2]
    out[6] += s[6] + 2.0 * dy * s[1] + n * dy * dy
    out[7] += s[7] + dy * s[2]
    out[8] += s[8]


@kernel()
def _sum_children(tree, node):
    """Set a node's sums to those of its children."""
    quarter = 0.5 * tree.half / (1 << tree.depth[node])
    s = np.zeros(SUMS)
    for q in range(4):
        c = tree.child[node] + q
        dx = quarter if q & 1 else -quarter
        dy = quarter if q & 2 else -quarter
        add_shifted(s, tree.sums[c], np.float64(tree.count[c]), dx, dy)
    for k in range(SUMS):
        tree.sums[node, k] = s[k]


@kernel()
def _split(tree, node, used, version):
    """Give a leaf four children and hand its runs down; return nodes and runs used."""
    nodes, runs = used
    first = nodes
    depth = tree.depth[node] + 1
    for q in range(4):
        c = first + q
        tree.child[c] = -1
        tree.depth[c] = depth
        tree.column[c] = 2 * tree.column[node] + (q & 1)
        tree.row[c] = 2 * tree.row[node] + (q >> 1)
        tree.count[c] = 0
        tree.sums[c] = 0.0
        tree.stamp[c] = version
        tree.head[c] = -1
    tree.child[node] = first
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
    return nodes + 4, runs


@kernel(inline=True)
def _towards(tree, node, depth, key):
    """Return the child of a node at `depth` whose cell holds a key."""
    return tree.child[node] + ((key >> (2 * (tree.depths - depth - 1))) & 3)


@kernel(inline=True)
def _leaf_of(tree, key):
    """Return the leaf whose cell holds a key, and its depth."""
    node = 0
    depth = 0
    while tree.child[node] >= 0:
        node = _towards(tree, node, depth, key)
        depth += 1
    return node, depth


@kernel(inline=True)
def _end_of_cell(key, i, shift):
    """Return the first key after `i` outside its cell; keys are sorted, a cell is a prefix."""
    prefix = key[i] >> shift
    j = i + 1
    while j < key.size and key[j] >> shift == prefix:
        j += 1
    return j


@kernel(inline=True)
def _count_down_to(tree, leaf, key, more, version, touched, count):
    """Count `more` points in a leaf and all above it; list those first touched by this batch."""
    node = 0
    depth = 0
    while True:
        if tree.stamp[node] != version:
            tree.stamp[node] = version
            touched[count] = node
            count += 1
        tree.count[node] += more
        if node == leaf:
            return count
        node = _towards(tree, node, depth, key)
        depth += 1


@kernel()
def insert(tree, key, base, begin, used, split_count, version):
    """Insert a sorted batch that lies in the pool from `base` on.

    Goes on from point `begin` of the batch until it is in or an array might be too small.

    Returns
    -------
    at, nodes, runs
        First point not inserted, nodes and runs in use.
    """
    nodes, runs = used
    touched = np.empty(tree.child.size, np.int32)
    count = 0
    stack = np.empty(STACK, np.int32)
    depths = tree.depths
    i = begin
    while i < key.size:
        leaf, depth = _leaf_of(tree, key[i])
        j = _end_of_cell(key, i, 2 * (depths - depth))
        # At each depth below at most total / split_count cells split; each cut run has a point.
        total = tree.count[leaf] + (j - i)
        if nodes + 4 * (depths - depth) * (total // split_count) >= tree.child.size:
            break
        if runs + total + 1 >= tree.start.size:
            break
        count = _count_down_to(tree, leaf, key[i], j - i, version, touched, count)
        tree.start[runs] = base + i
        tree.length[runs] = j - i
        tree.following[runs] = tree.head[leaf]
        tree.head[leaf] = runs
        runs += 1
        if total < split_count or depth == depths:
            _add_to_sums(tree, leaf, base + i, base + j)
        else:
            stack[0] = leaf
            top = 1
            while top > 0:
                top -= 1
                m = stack[top]
                if tree.count[m] < split_count or tree.depth[m] == depths:
                    run = tree.head[m]
                    while run >= 0:
                        first = tree.start[run]
                        _add_to_sums(tree, m, first, first + tree.length[run])
                        run = tree.following[run]
                    continue
                nodes, runs = _split(tree, m, (nodes, runs), version)
                if m != leaf:
                    touched[count] = m
                    count += 1
                for q in range(4):
                    stack[top] = tree.child[m] + q
                    top += 1
        i = j
    # A child is always touched after its parent.
    for t in range(count - 1, -1, -1):
        if tree.child[touched[t]] >= 0:
            _sum_children(tree, touched[t])
    return i, nodes, runs


@kernel()
def node_at(tree, x, y, smallest, largest):
    """Return the smallest cell at a point between two depths (the band), -1 for none.

    `smallest` is the greater depth. Coordinates are relative to the root's centre.
    """
    if not (-tree.half <= x < tree.half and -tree.half <= y < tree.half):
        return -1
    node = 0
    while tree.child[node] >= 0 and tree.depth[node] < smallest:
        cx, cy = cell_centre(tree, node)
        node = tree.child[node] + (1 if x >= cx else 0) + (2 if y >= cy else 0)
    return node if tree.depth[node] >= largest and tree.count[node] > 0 else -1


@kernel()
def band(tree, smallest, largest, since):
    """Return the smallest cells between two depths that got points after batch `since`."""
    found = np.empty(tree.child.size, np.int32)
    n = 0
    stack = np.empty(STACK, np.int32)
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        if tree.stamp[node] <= since or tree.count[node] == 0:
            continue
        if tree.child[node] >= 0 and tree.depth[node] < smallest:
            for q in range(3, -1, -1):
                stack[top] = tree.child[node] + q
                top += 1
        elif tree.depth[node] >= largest:
            found[n] = node
            n += 1
    return found[:n].copy()


@kernel()
def points_in(tree, west, east, south, north):
    """Return the pool indices of the points in a closed rectangle, relative to the centre."""
    found = np.empty(1024, np.int64)
    n = 0
    stack = np.empty(STACK, np.int32)
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        if tree.count[node] == 0:
            continue
        cx, cy = cell_centre(tree, node)
        reach = tree.half / (1 << tree.depth[node])
        if cx - reach > east or cx + reach < west or cy - reach > north or cy + reach < south:
            continue
        if tree.child[node] >= 0:
            for q in range(4):
                stack[top] = tree.child[node] + q
                top += 1
            continue
        run = tree.head[node]
        while run >= 0:
            begin = tree.start[run]
            for i in range(begin, begin + tree.length[run]):
                if west <= tree.xyz[i, 0] <= east and south <= tree.xyz[i, 1] <= north:
                    found = with_room(found, n)
                    found[n] = i
                    n += 1
            run = tree.following[run]
    return found[:n].copy()
