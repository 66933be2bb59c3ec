# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled nearest-neighbour search in the plane on a grid of squares."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

# Mean number of places per square, and number of places up to which there is only one square.
_PLACES_PER_SQUARE, _MAX_UNDIVIDED = 2.0, 48
# Maximum number of rows and of columns of the grid, and minimum extent to be divided, m.
_MAX_ROWS, _MIN_EXTENT_M = 256, 1e-6


@kernel(allocates=False)
def _insert(i, squared_distance, count, indices, squared_distances):
    """Insert point i into a sorted list of nearest points; return the list's length.

    `count` is the length before, and `squared_distance` that of point i. `indices` (k,) and
    `squared_distances` (k,) are the list, nearest first; if it is full, the farthest point is
    dropped. Of points at the same distance those with lower indices come first.
    """
    k = indices.size
    if count == k and not (
        squared_distance < squared_distances[k - 1]
        or (squared_distance == squared_distances[k - 1] and i < indices[k - 1])
    ):
        return count
    at = count if count < k else k - 1
    while at > 0 and (
        squared_distance < squared_distances[at - 1]
        or (squared_distance == squared_distances[at - 1] and i < indices[at - 1])
    ):
        squared_distances[at], indices[at] = squared_distances[at - 1], indices[at - 1]
        at -= 1
    squared_distances[at], indices[at] = squared_distance, i
    return min(count + 1, k)


@kernel()
def sort_by_square(east, north):
    """Sort points by the square of a grid that they lie in.

    The coordinates of the points are `east` and `north` (n,), m. The results are the indices of the
    points (n,), square by square, in their original order within each; the start of each square in
    this order, and the end (rows * cols + 1,); and the grid (5,): west and south edge and side of a
    square, m, rows and columns. There is only one square if there are few points, they lie on a
    line east or north, or one is not finite.
    """
    n = len(east)
    west, south = east.min(), north.min()
    wide, high = east.max() - west, north.max() - south
    grid = np.array([west, south, np.inf, 1.0, 1.0])
    if n > _MAX_UNDIVIDED and _MIN_EXTENT_M < wide < np.inf and _MIN_EXTENT_M < high < np.inf:
        side = max(np.sqrt(wide * high * _PLACES_PER_SQUARE / n), max(wide, high) / _MAX_ROWS)
        grid[2], grid[3], grid[4] = side, np.floor(high / side) + 1.0, np.floor(wide / side) + 1.0
    rows, cols = int(grid[3]), int(grid[4])
    first = np.zeros(rows * cols + 1, np.int64)
    square = np.zeros(n, np.int64)
    if rows * cols > 1:
        for i in range(n):
            row = min(int((north[i] - south) / grid[2]), rows - 1)
            square[i] = row * cols + min(int((east[i] - west) / grid[2]), cols - 1)
    for i in range(n):
        first[square[i] + 1] += 1
    for s in range(rows * cols):
        first[s + 1] += first[s]
    order = np.empty(n, np.int64)
    to = first[:-1].copy()
    for i in range(n):
        order[to[square[i]]] = i
        to[square[i]] += 1
    return order, first, grid


@kernel(allocates=False)
def _search_square(
    row, col, cols, east, north, x, y, order, first, count, indices, squared_distances
):
    """Insert the points of one grid square into the list of nearest points.

    The return value is the list's length. The square is given by `row` and `col` of `cols` columns;
    distances are from (`x`, `y`). The other parameters are those of `sort_by_square` and `_insert`.
    """
    square = row * cols + col
    for k in range(first[square], first[square + 1]):
        i = order[k]
        dx, dy = east[i] - x, north[i] - y
        count = _insert(i, dx * dx + dy * dy, count, indices, squared_distances)
    return count


@kernel(allocates=False)
def find_nearest(east, north, x, y, squares, indices, squared_distances):
    """Find the k points nearest to (x, y), nearest first, in a grid of squares.

    Their indices are written to `indices` (k,) and the squared distances to `squared_distances`
    (k,); the return value is their number. If there are fewer than k points, the remaining elements
    stay unchanged. Of points at the same distance those with lower indices come first. `squares` is
    the result of `sort_by_square` for the coordinates `east` and `north` (n,). Squares are searched
    in rings about (x, y); points in ring n are at least n - 1 sides away.
    """
    order, first, grid = squares
    side, rows, cols = grid[2], int(grid[3]), int(grid[4])
    row = col = count = 0
    if rows * cols > 1:
        col = int(min(max((x - grid[0]) / side, 0.0), cols - 1.0))
        row = int(min(max((y - grid[1]) / side, 0.0), rows - 1.0))
    for ring in range(max(rows, cols)):
        if count == indices.size and ring > 0:
            min_distance = (ring - 1) * side
            if squared_distances[count - 1] < min_distance * min_distance:
                break
        for i in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            edge = i == row - ring or i == row + ring
            step = 1 if edge else max(2 * ring, 1)
            for j in range(col - ring, col + ring + 1, step):
                if 0 <= j < cols:
                    count = _search_square(
                        i,
                        j,
                        cols,
                        east,
                        north,
                        x,
                        y,
                        order,
                        first,
                        count,
                        indices,
                        squared_distances,
                    )
    return count
