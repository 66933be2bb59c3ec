# mypy: allow-untyped-defs, no-check-untyped-defs
"""Data structure of a quadtree for compiled kernels, and queries of it.

Nodes are stored in parallel arrays. The four children of a node are consecutive, so one index
locates them, and the index of a parent is always below those of its children. A leaf owns its
points as a chain of runs: sections of the pool, in which every batch is sorted along the Z-order
curve.

Quadrant q of a node is east if q & 1 and north if q & 2.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lunarsim._jit import kernel

# Maximum stack of a traversal: three siblings wait at each of at most 16 levels.
STACK = 64


class Tree(NamedTuple):
    """Arrays of a quadtree of points, in a form that compiled kernels accept.

    There are n points, N cells (nodes) and S sets of moment sums. `child` is the index of the first
    of four consecutive children. The points of a leaf are a chain of runs: `head` is its first run,
    `following` the next one, and `start` and `length` give the section of `xyz` of each run.
    """

    half: float  # half the side of the root, m
    depths: int  # depth of the smallest cells
    xyz: Any  # points (n, 3) relative to the centre of the root, m, float32
    is_outlier: Any  # outliers in height (n,), bool
    child: Any  # first child, -1 for a leaf (N,)
    depth: Any  # depth, 0 for the root (N,)
    column: Any  # column of the cell among those of its depth, from the west (N,)
    row: Any  # row, from the south (N,)
    count: Any  # number of points (N,)
    stamp: Any  # number of the last batch that added points (N,)
    head: Any  # first run, -1 for none (N,)
    slot: Any  # index into the sums, -1 for none (N,)
    sums: Any  # sums (S, 12)
    start: Any  # first point of each run, in the pool
    length: Any
    following: Any  # next run, -1 for the last


@kernel(inner=True)
def with_capacity(array, n):
    """Return an array with space for entry `n`, enlarged if necessary.

    The first `n` entries of `array` are kept.
    """
    if n < array.size:
        return array
    grown = np.empty(2 * n + 64, array.dtype)
    grown[:n] = array
    return grown


@kernel(inline=True, inner=True)
def cell_centre(tree, node):
    """Return the centre (x, y) of a cell relative to the centre of the map, m.

    `node` is the index of the cell.
    """
    size = 2.0 * tree.half / (1 << tree.depth[node])
    return (
        (tree.column[node] + 0.5) * size - tree.half,
        (tree.row[node] + 0.5) * size - tree.half,
    )


@kernel()
def node_at(tree, x, y, smallest, largest):
    """Return the smallest cell at a point, within a band of cell sizes; -1 for none.

    `x` and `y` are relative to the centre of the map, m. `smallest` and `largest` are the depths of
    the smallest and largest cells in the band, so `smallest` is the greater number. The result is
    -1 off the map, in an empty cell, and where all cells are larger than the band.
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
    """Return the smallest cells within a band of sizes that got points since a batch.

    `smallest` and `largest` are the depths of the smallest and largest cells in the band. `since`
    is the number of a batch; only cells with points from later batches are returned, as indices
    (n,). They do not overlap: at each place it is the smallest cell of the band that exists.
    """
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
    """Return the indices of all points in a closed rectangle (n,).

    The sides of the rectangle are relative to the centre of the map, m.
    """
    found = np.empty(1024, np.int64)
    n = np.int64(0)  # a typed zero, so that functions compile once
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
                    found = with_capacity(found, n)
                    found[n] = i
                    n += 1
            run = tree.following[run]
    return found[:n].copy()
