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
def _insert(i, d, count, chosen, away):
    """Insert place i into the sorted list of nearest neighbours; return their number.

    `d` is the squared distance of the place and `count` the number of neighbours so far. At most as
    many are kept as fit into `chosen` (k,), their indices, and `away` (k,), their squared
    distances; of places at the same distance those with lower indices come first.
    """
    k = chosen.size
    if count == k and not (d < away[k - 1] or (d == away[k - 1] and i < chosen[k - 1])):
        return count
    at = count if count < k else k - 1
    while at > 0 and (d < away[at - 1] or (d == away[at - 1] and i < chosen[at - 1])):
        away[at], chosen[at] = away[at - 1], chosen[at - 1]
        at -= 1
    away[at], chosen[at] = d, i
    return min(count + 1, k)


@kernel()
def sort_by_square(east, north):
    """Sort places, with coordinates `east` and `north` (n,), by grid square.

    Returns
    -------
    order
        Indices of the places (n,), square by square, in their original order within each.
    first
        Start of each square in `order`, and the end (rows * cols + 1,). There is only one square if
        there are few places, they lie on a line east or north, or one is not finite.
    box
        West and south edge, side, rows and columns (5,).
    """
    n = len(east)
    west, south = east.min(), north.min()
    wide, high = east.max() - west, north.max() - south
    box = np.array([west, south, np.inf, 1.0, 1.0])
    if n > _MAX_UNDIVIDED and _MIN_EXTENT_M < wide < np.inf and _MIN_EXTENT_M < high < np.inf:
        side = max(np.sqrt(wide * high * _PLACES_PER_SQUARE / n), max(wide, high) / _MAX_ROWS)
        box[2], box[3], box[4] = side, np.floor(high / side) + 1.0, np.floor(wide / side) + 1.0
    rows, cols = int(box[3]), int(box[4])
    first = np.zeros(rows * cols + 1, np.int64)
    square = np.zeros(n, np.int64)
    if rows * cols > 1:
        for i in range(n):
            row = min(int((north[i] - south) / box[2]), rows - 1)
            square[i] = row * cols + min(int((east[i] - west) / box[2]), cols - 1)
    for i in range(n):
        first[square[i] + 1] += 1
    for s in range(rows * cols):
        first[s + 1] += first[s]
    order = np.empty(n, np.int64)
    to = first[:-1].copy()
    for i in range(n):
        order[to[square[i]]] = i
        to[square[i]] += 1
    return order, first, box


@kernel(allocates=False)
def _search_square(row, col, cols, east, north, x, y, order, first, count, chosen, away):
    """Insert the places of one grid square into the neighbours; return their number.

    The square is given by `row` and `col` of `cols` columns, the point by `x` and `y`. The other
    parameters are those of `sort_by_square` and `_insert`.
    """
    square = row * cols + col
    for at in range(first[square], first[square + 1]):
        i = order[at]
        dx, dy = east[i] - x, north[i] - y
        count = _insert(i, dx * dx + dy * dy, count, chosen, away)
    return count


@kernel(allocates=False)
def nearest(east, north, x, y, squares, chosen, away):
    """Write the places nearest to a finite point (x, y), nearest first.

    Their indices are written to `chosen` (k,) and the squared distances to `away` (k,). If there
    are fewer than k places, the remaining elements stay unchanged. Of places at the same distance
    those with lower indices come first. `squares` is the result of `sort_by_square` for the
    coordinates `east` and `north` (n,). Squares are searched in rings about the point's square, or
    the square nearest to the point; places in ring n are at least n - 1 sides away.
    """
    order, first, box = squares
    side, rows, cols = box[2], int(box[3]), int(box[4])
    row = col = count = 0
    if rows * cols > 1:
        col = int(min(max((x - box[0]) / side, 0.0), cols - 1.0))
        row = int(min(max((y - box[1]) / side, 0.0), rows - 1.0))
    for ring in range(max(rows, cols)):
        if count == chosen.size and ring > 0:
            least = (ring - 1) * side
            if away[count - 1] < least * least:
                break
        for i in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            edge = i == row - ring or i == row + ring
            step = 1 if edge else max(2 * ring, 1)
            for j in range(col - ring, col + ring + 1, step):
                if 0 <= j < cols:
                    count = _search_square(
                        i, j, cols, east, north, x, y, order, first, count, chosen, away
                    )
    return count
