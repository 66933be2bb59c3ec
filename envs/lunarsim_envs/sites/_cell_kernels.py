"""Compiled picks of cells from a map: the best of them, and the nearest that are good enough."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim._lanes import LANES, larger, load, store

# Of `candidates.best_cells`.
_PRICE = np.float32(1e-3 / 100.0)
# Stands for cells that are no site.
NOWHERE = np.float32(-1e30)
_NOUGHT, _WHOLE = np.float32(0.0), np.float32(1.0)


@kernel(finite=True)
def offsets(corner, posting, site, out):
    """Write how far columns lie from a site (cols,), m."""
    for c in range(len(out)):
        out[c] = np.float32(corner + c * posting - site)


@kernel(finite=True)
def _scored(aim, dy, offset, score):
    """Write how good each cell of a row is (cols,)."""
    for c in range(len(aim)):
        dx = offset[c]
        good = aim[c] * (_WHOLE - _PRICE * np.sqrt(dx * dx + dy * dy))
        score[c] = good if aim[c] > _NOUGHT else NOWHERE


@kernel()
def greatest(cells, row):
    """Return the greatest of a row of cells (rows, cols) without NaN."""
    cols = cells.shape[1]
    best = cells[row, 0]
    if cols < LANES:
        for c in range(cols):
            best = max(best, cells[row, c])
        return best
    flat, first = cells.reshape(-1), row * cols
    # The last sixteen overlap those before them.
    sixteen, each = load(flat, first + cols - LANES), np.empty(LANES, np.float32)
    for c in range(0, cols - LANES, LANES):
        sixteen = larger(load(flat, first + c), sixteen)
    store(each, 0, sixteen)
    for k in range(LANES):
        best = max(best, each[k])
    return best


@kernel()
def score_all(aim, corner, posting, site, score, most, highest):
    """Write how good each cell is (rows, cols), the best of each row and of its aim (rows,)."""
    rows, cols = aim.shape
    offset = np.empty(cols, np.float32)
    offsets(corner[0], posting, site[0], offset)
    for r in range(rows):
        dy = np.float32(corner[1] + r * posting - site[1])
        _scored(aim[r], dy, offset, score[r])
        most[r], highest[r] = greatest(score, r), greatest(aim, r)


@kernel(inner=True)
def halves_of(separation, posting, out):
    """Write how many cells to a side are too near, of rows that are so many apart (m,)."""
    for apart in range(len(out)):
        out[apart] = 0
        while np.hypot(apart, out[apart]) * posting < separation:
            out[apart] += 1


@kernel(inner=True)
def clear(score, most, row, col, halves):
    """Take the cells about one out of the choice; see `halves_of`."""
    rows, cols = score.shape
    wide = len(halves) - 1
    for r in range(max(row - wide, 0), min(row + wide + 1, rows)):
        half = halves[abs(r - row)]
        for c in range(max(col - half + 1, 0), min(col + half, cols)):
            score[r, c] = NOWHERE
        most[r] = greatest(score, r)


@kernel()
def best_cells(aim, corner, posting, site, count, separation, score, highest, cells):
    """Write up to `count` cells (m, 2) of greatest aim and return how many.

    See `candidates.best_cells`. `highest` (rows,) takes the greatest aim of each row.
    """
    rows = len(aim)
    most = np.empty(rows, np.float32)
    score_all(aim, corner, posting, site, score, most, highest)
    halves = np.empty(int(np.ceil(separation / posting)) + 1, np.int64)
    halves_of(separation, posting, halves)
    for n in range(count):
        row = 0
        for r in range(1, rows):
            if most[r] > most[row]:
                row = r
        if most[row] <= NOWHERE:
            return n
        col = 0
        while score[row, col] != most[row]:
            col += 1
        cells[n, 0], cells[n, 1] = row, col
        clear(score, most, row, col, halves)
    return count


@kernel()
def nearest(aim, corner, posting, site, level, highest, place):
    """Write the nearest cell of an aim of at least `level` (2,); tell whether there is one.

    Rows are gone through from the site's outward, as far as one may still be nearer.
    """
    rows, cols = aim.shape
    middle = min(max(int(np.floor((site[1] - corner[1]) / posting + 0.5)), 0), rows - 1)
    best = np.inf
    for k in range(2 * rows):
        r = middle + (k + 1) // 2 if k % 2 == 1 else middle - k // 2
        if not 0 <= r < rows:
            continue
        dy = corner[1] + r * posting - site[1]
        if dy * dy > best or highest[r] < level:
            continue
        for c in range(cols):
            if aim[r, c] >= level:
                dx = corner[0] + c * posting - site[0]
                far = dx * dx + dy * dy
                if far < best or (far == best and r < place[0]):
                    best = far
                    place[0], place[1] = r, c
    return best < np.inf


@kernel()
def nearest_cells(aim, corner, posting, site, levels, count, highest, cells):
    """Add the nearest cell at each level of aim that is not among them; return how many."""
    place = np.empty(2, np.int64)
    for k in range(len(levels)):
        known = not nearest(aim, corner, posting, site, levels[k], highest, place)
        for n in range(count):
            known = known or (cells[n, 0] == place[0] and cells[n, 1] == place[1])
        if not known:
            cells[count, 0], cells[count, 1] = place[0], place[1]
            count += 1
    return count
