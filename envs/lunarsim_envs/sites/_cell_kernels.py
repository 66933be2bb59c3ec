# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled selection of map cells: the best scores, and the nearest safe cells.

In all functions, `aim` (rows, cols) is p_safe averaged over the landing dispersion, `corner` (2,)
and `posting` are position and spacing of cells, m, and `site` is the current site. The score of a
cell is `aim`, slightly reduced with its distance from the site.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim._simd import SIMD_WIDTH, lane_max, load, store

# Constant of `candidates.best_cells`.
_PRICE = np.float32(1e-3 / 100.0)
# Score of excluded cells.
NOWHERE = np.float32(-1e30)
_NOUGHT, _WHOLE = np.float32(0.0), np.float32(1.0)


@kernel(finite=True)
def offsets(corner, posting, site, out):
    """Write the east offset of each map column from a site to `out` (cols,), m."""
    for c in range(len(out)):
        out[c] = np.float32(corner + c * posting - site)


@kernel(finite=True)
def _scored(aim, dy, offset, score):
    """Write the scores of the cells of one row (cols,); `aim` 0 excludes a cell.

    `dy` and `offset` (cols,) are the north and east offsets of cells from the site, m.
    """
    for c in range(len(aim)):
        dx = offset[c]
        good = aim[c] * (_WHOLE - _PRICE * np.sqrt(dx * dx + dy * dy))
        score[c] = good if aim[c] > _NOUGHT else NOWHERE


@kernel()
def row_max(cells, row):
    """Return the maximum of one row of an array (rows, cols) without NaN."""
    cols = cells.shape[1]
    best = cells[row, 0]
    if cols < SIMD_WIDTH:
        for c in range(cols):
            best = max(best, cells[row, c])
        return best
    flat, first = cells.reshape(-1), row * cols
    # The last sixteen elements overlap the previous ones.
    sixteen, each = load(flat, first + cols - SIMD_WIDTH), np.empty(SIMD_WIDTH, np.float32)
    for c in range(0, cols - SIMD_WIDTH, SIMD_WIDTH):
        sixteen = lane_max(load(flat, first + c), sixteen)
    store(each, 0, sixteen)
    for k in range(SIMD_WIDTH):
        best = max(best, each[k])
    return best


@kernel()
def score_all(aim, corner, posting, site, score, most, highest):
    """Compute the scores of all cells, `score` (rows, cols).

    Also writes the maximum of each row of the scores to `most` and of `aim` to `highest` (rows,).
    """
    rows, cols = aim.shape
    offset = np.empty(cols, np.float32)
    offsets(corner[0], posting, site[0], offset)
    for r in range(rows):
        dy = np.float32(corner[1] + r * posting - site[1])
        _scored(aim[r], dy, offset, score[r])
        most[r], highest[r] = row_max(score, r), row_max(aim, r)


@kernel(inner=True)
def halves_of(separation, posting, out):
    """Write the half width of a disc of radius `separation` (m) in each row of cells.

    Entry k of `out`, in cells, is for the rows k cells from the centre.
    """
    for apart in range(len(out)):
        out[apart] = 0
        while np.hypot(apart, out[apart]) * posting < separation:
            out[apart] += 1


@kernel(inner=True)
def clear(score, most, row, col, halves):
    """Exclude the cells in a disc around a chosen cell from further choices.

    `halves` are the half widths from `halves_of`; updates `score` and its row maxima `most`.
    """
    rows, cols = score.shape
    wide = len(halves) - 1
    for r in range(max(row - wide, 0), min(row + wide + 1, rows)):
        half = halves[abs(r - row)]
        for c in range(max(col - half + 1, 0), min(col + half, cols)):
            score[r, c] = NOWHERE
        most[r] = row_max(score, r)


@kernel()
def best_cells(aim, corner, posting, site, count, separation, score, highest, cells):
    """Select up to `count` cells with the highest scores, `separation` (m) apart.

    The separation is a minimum. Writes row and column to `cells` (m, 2), and returns the number of
    cells. `score` (rows, cols) is scratch; `highest` (rows,) gets the row maxima of `aim`.
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
    """Find the cell nearest to the site with `aim` of at least `level`.

    Writes row and column to `place` (2,), and returns whether there is such a cell. `highest`
    (rows,) are the row maxima of `aim`.
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
    """Append the nearest cell at each minimum `aim` of `levels` to a list of cells.

    `cells` (m, 2) has `count` cells before; cells in the list are not repeated. Returns the new
    number of cells.
    """
    place = np.empty(2, np.int64)
    for k in range(len(levels)):
        known = not nearest(aim, corner, posting, site, levels[k], highest, place)
        for n in range(count):
            known = known or (cells[n, 0] == place[0] and cells[n, 1] == place[1])
        if not known:
            cells[count, 0], cells[count, 1] = place[0], place[1]
            count += 1
    return count
