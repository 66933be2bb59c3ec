"""Compiled search for the nearest of many places: those of a square lie side by side."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

# So many places lie on a square in the mean, and of no more than so many all are looked at.
_A_SQUARE, _FEW = 2.0, 48
# Columns and rows of squares, about as many at most, and the least extent that is cut into any, m.
_MOST, _LEAST = 256, 1e-6


@kernel(allocates=False)
def _insert(i, d, count, chosen, away):
    """Insert place i at distance d (squared) among the nearest so far; return how many there are.

    No more than `chosen` (k,) and `away` (k,) hold; of places that are as far the first count.
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
def on_squares(east, north):
    """Sort places (n,) by the squares that they lie on.

    Returns
    -------
    order
        Of the places (n,), square after square, in each as they were.
    first
        Where each square begins in it, and the end (rows * cols + 1,). Of one square if there are
        few places, they lie on a line east or north, or one is not finite.
    box
        West and south edge, side, rows and columns (5,).
    """
    n = len(east)
    west, south = east.min(), north.min()
    wide, high = east.max() - west, north.max() - south
    box = np.array([west, south, np.inf, 1.0, 1.0])
    if n > _FEW and _LEAST < wide < np.inf and _LEAST < high < np.inf:
        side = max(np.sqrt(wide * high * _A_SQUARE / n), max(wide, high) / _MOST)
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
def _look_through(row, col, cols, east, north, x, y, order, first, count, chosen, away):
    """Take what lies on one square among the nearest; return how many there are."""
    square = row * cols + col
    for at in range(first[square], first[square + 1]):
        i = order[at]
        dx, dy = east[i] - x, north[i] - y
        count = _insert(i, dx * dx + dy * dy, count, chosen, away)
    return count


@kernel(allocates=False)
def nearest(east, north, x, y, squares, chosen, away):
    """Write which of the places (n,) lie nearest to a finite point, nearest first.

    As many as `chosen` (k,) and `away` (k,), the squares of their distances, hold; of places that
    are as far the first. `squares` is what `on_squares` gives. Squares are looked through ring by
    ring about that on which the point lies, or the nearest one; those of a ring lie no nearer than
    by one side less than their number.
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
                    count = _look_through(
                        i, j, cols, east, north, x, y, order, first, count, chosen, away
                    )
    return count
