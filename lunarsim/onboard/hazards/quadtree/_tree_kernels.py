"""Compiled quadtree: insertion of sorted batches, and queries.

Nodes live in parallel arrays; the four children of a node are consecutive, so one index finds them,
and a parent's index is always below its children's. A leaf owns its points as a chain of runs:
stretches of the pool, where every batch lies sorted along the Z-order curve. Splitting a leaf cuts
its runs and moves no point.

Quadrant q of a node lies east if q & 1 and north if q & 2.

Sums are kept for nodes with children and for least cells with many points; a leaf without them has
few points to walk over. They leave out points that stand apart: a return off a bird or off nothing
lies farther in height from all others of its cell than ground and rocks can, and one at 1000 m
would lift the mean of hundreds. Which points these are depends on what the cell holds alone, not on
the order in which it came.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lunarsim._jit import kernel

DIGIT = 11  # bits a pass of the radix sort
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
# Deepest walk: three siblings wait at each of at most 16 levels.
STACK = 64


class Tree(NamedTuple):
    """What kernels need of a quadtree."""

    half: float  # half the root's side, m
    depths: int  # depth of the least cells
    xyz: Any  # points (n, 3) relative to the root's centre, float32
    apart: Any  # points that stand apart (n,), bool
    child: Any  # first child, -1 for a leaf (N,)
    depth: Any  # (N,)
    column: Any  # of the cell among those of its depth, from the west (N,)
    row: Any  # from the south (N,)
    count: Any  # points (N,)
    stamp: Any  # number of the last batch that added points (N,)
    head: Any  # first run, -1 for none (N,)
    slot: Any  # place among the sums, -1 for none (N,)
    sums: Any  # (S, 12)
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
    order = np.arange(n).astype(np.int32)
    spare = np.empty(n, np.int32)
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
def place(points, centre, half, depths, highest):
    """Sort points (n, 3) along the Z-order curve of the least cells.

    Returns
    -------
    xyz, key
        Of the points on the map (m, 3) and (m,), relative to its centre.
    outside, missing, high
        How many lie outside, how many are no numbers, and how many are on the map but farther than
        `highest` from its elevation.
    """
    n = points.shape[0]
    side = 1 << depths
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
        if abs(z) > highest:
            high += 1
            continue
        kept[m, 0] = x
        kept[m, 1] = y
        kept[m, 2] = z
        key[m] = _spread(column) | (_spread(row) << 1)
        m += 1
    order = _order_of(key[:m], 2 * depths)
    xyz = np.empty((m, 3), np.float32)
    sorted_key = np.empty(m, np.uint32)
    for i in range(m):
        j = order[i]
        xyz[i, 0] = kept[j, 0]
        xyz[i, 1] = kept[j, 1]
        xyz[i, 2] = kept[j, 2]
        sorted_key[i] = key[j]
    return xyz, sorted_key, outside, missing, high


@kernel(inline=True)
def cell_centre(tree, node):
    """Return the centre of a node, relative to the root's."""
    size = 2.0 * tree.half / (1 << tree.depth[node])
    return (
        (tree.column[node] + 0.5) * size - tree.half,
        (tree.row[node] + 0.5) * size - tree.half,
    )


@kernel(inline=True)
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


@kernel(inline=True)
def empty_sums(s):
    """Set sums to those of no point."""
    for k in range(LOWEST):
        s[k] = 0.0
    s[LOWEST] = np.inf
    s[HIGHEST] = -np.inf


@kernel(inline=True)
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


@kernel()
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


@kernel()
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
    n = 0
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


@kernel()
def _settle(tree, node, found):
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


@kernel()
def _add_to_many(tree, leaf, first, last, found):
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
            return _settle(tree, leaf, found)
    cx, cy = cell_centre(tree, leaf)
    for i in range(first, last):
        x, y = np.float64(tree.xyz[i, 0]) - cx, np.float64(tree.xyz[i, 1]) - cy
        tree.apart[i] = False
        add_point(s, x, y, np.float64(tree.xyz[i, 2]))
    return found


@kernel()
def _split(tree, node, used, version):
    """Give a leaf four children and hand its runs down; return nodes, runs and sums used."""
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
def _enter(tree, leaf, run, split_count, used, version, touched, count, found):
    """Divide a leaf that has got a run if it must; bring the sums of least cells up to date.

    Returns
    -------
    used, count, found
        Nodes, runs and sums in use, cells listed in `touched`, and `found`, perhaps enlarged.
    """
    nodes, runs, slots = used
    depths = tree.depths
    first, more = tree.start[run], tree.length[run]
    if tree.depth[leaf] == depths and tree.slot[leaf] >= 0:
        return used, count, _add_to_many(tree, leaf, first, first + more, found)
    stack = np.empty(STACK, np.int32)
    stack[0] = leaf
    top = 1
    while top > 0:
        top -= 1
        m = stack[top]
        if tree.depth[m] == depths:
            if tree.count[m] >= MANY:
                tree.slot[m] = slots
                slots += 1
                found = _settle(tree, m, found)
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
    return (nodes, runs, slots), count, found


@kernel()
def insert(tree, key, base, begin, used, split_count, version):
    """Insert a sorted batch that lies in the pool from `base` on.

    Goes on from point `begin` of the batch until it is in or an array might be too small.

    Returns
    -------
    at, nodes, runs, slots
        First point not inserted; nodes, runs and sums in use.
    """
    nodes, runs, slots = used
    touched = np.empty(tree.child.size, np.int32)
    count = 0
    found = np.empty(256, np.int64)
    depths = tree.depths
    i = begin
    while i < key.size:
        leaf, depth = _leaf_of(tree, key[i])
        j = _end_of_cell(key, i, 2 * (depths - depth))
        # At each depth below at most total / split_count cells split; each cut run has a point.
        total = tree.count[leaf] + (j - i)
        divided = (depths - depth) * (total // split_count)
        if (
            nodes + 4 * divided >= tree.child.size
            or runs + total + 1 >= tree.start.size
            or slots + divided + total // MANY >= tree.sums.shape[0]
        ):
            break
        count = _count_down_to(tree, leaf, key[i], j - i, version, touched, count)
        tree.start[runs] = base + i
        tree.length[runs] = j - i
        tree.following[runs] = tree.head[leaf]
        tree.head[leaf] = runs
        tree.apart[base + i : base + j] = False
        (nodes, runs, slots), count, found = _enter(
            tree, leaf, runs, split_count, (nodes, runs + 1, slots), version, touched, count, found
        )
        i = j
    # A child is always touched after its parent.
    for t in range(count - 1, -1, -1):
        if tree.child[touched[t]] >= 0:
            found = _settle(tree, touched[t], found)
    return i, nodes, runs, slots


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
