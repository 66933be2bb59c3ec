# mypy: allow-untyped-defs, no-check-untyped-defs
"""Candidate cells of a map: the best scores, and the nearest safe cells.

In all functions, `p_safe` (rows, cols) is averaged over the landing dispersion, `corner` (2,) and
`posting` are position and spacing of cells, m, and `site` is the current site. The score of a cell
is `p_safe`, slightly reduced with its distance from the site.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim._simd import SIMD_WIDTH, lane_max, load, store

# Fraction of p_safe that 1 m of distance costs, so that the nearer of equally safe sites wins. The
# cost is relative, because p_safe differs only in the third decimal where the map is uncertain
# everywhere.
_DISTANCE_WEIGHT = np.float32(1e-3 / 100.0)
# Score of excluded cells.
NOWHERE = np.float32(-1e30)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@kernel(finite=True)
def east_offsets(west, posting, site_east, out):
    """Write the east offset of each map column from a site to `out` (cols,), m.

    `west` and `site_east` are the east coordinates of the first column and of the site, and
    `posting` is the spacing of the columns, m.
    """
    for c in range(len(out)):
        out[c] = np.float32(west + c * posting - site_east)


@kernel(finite=True)
def _score_row(p_safe, north_offset, east_offset, score):
    """Write the scores of the cells of one map row to `score` (cols,).

    The score is `p_safe` (cols,), slightly reduced with the distance from the site, which
    `north_offset` and `east_offset` (cols,) give, m. A cell with p_safe 0 is excluded: its score is
    `NOWHERE`.
    """
    for c in range(len(p_safe)):
        east = east_offset[c]
        distance = np.sqrt(east * east + north_offset * north_offset)
        value = p_safe[c] * (_ONE - _DISTANCE_WEIGHT * distance)
        score[c] = value if p_safe[c] > _ZERO else NOWHERE


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
def score_all(p_safe, corner, posting, site, score, score_maxima, p_safe_maxima):
    """Write `score` (rows, cols): p_safe slightly reduced with distance from the site.

    Cells with p_safe 0 are excluded: their score is `NOWHERE`. `corner` (2,) is the centre of cell
    (0, 0), and `posting` the spacing of the cells, m. The maximum of each row of `score` and
    `p_safe` is written to `score_maxima` and `p_safe_maxima` (rows,).
    """
    rows, cols = p_safe.shape
    offset = np.empty(cols, np.float32)
    east_offsets(corner[0], posting, site[0], offset)
    for r in range(rows):
        dy = np.float32(corner[1] + r * posting - site[1])
        _score_row(p_safe[r], dy, offset, score[r])
        score_maxima[r], p_safe_maxima[r] = row_max(score, r), row_max(p_safe, r)


@kernel(inner=True)
def disc_half_widths(separation, posting, out):
    """Write the half width of a disc of radius `separation` (m) in each row of cells.

    Entry k of `out` is for the rows k cells from the centre: the number of columns from the centre
    to the first cell outside the disc. `posting` is the spacing of the cells, m.
    """
    for apart in range(len(out)):
        out[apart] = 0
        while np.hypot(apart, out[apart]) * posting < separation:
            out[apart] += 1


@kernel(inner=True)
def exclude_disc(score, score_maxima, row, col, half_widths):
    """Exclude the cells in a disc around the cell (row, col) from further choices.

    Their `score` (rows, cols) becomes `NOWHERE`, and the row maxima `score_maxima` (rows,) are
    updated. `half_widths` are from `disc_half_widths`.
    """
    rows, cols = score.shape
    wide = len(half_widths) - 1
    for r in range(max(row - wide, 0), min(row + wide + 1, rows)):
        half = half_widths[abs(r - row)]
        for c in range(max(col - half + 1, 0), min(col + half, cols)):
            score[r, c] = NOWHERE
        score_maxima[r] = row_max(score, r)


@kernel()
def best_cells(p_safe, corner, posting, site, count, separation, score, p_safe_maxima, cells):
    """Select up to `count` cells with the highest scores, at a minimum separation.

    The score is p_safe, slightly reduced with distance from the site; `separation` is in m. Row and
    column of each selected cell are written to `cells` (m, 2); their number is returned. `score`
    (rows, cols) is scratch; `p_safe_maxima` (rows,) receives the row maxima of `p_safe`. `corner`
    and `posting` are those of `score_all`.
    """
    rows = len(p_safe)
    score_maxima = np.empty(rows, np.float32)
    score_all(p_safe, corner, posting, site, score, score_maxima, p_safe_maxima)
    half_widths = np.empty(int(np.ceil(separation / posting)) + 1, np.int64)
    disc_half_widths(separation, posting, half_widths)
    for n in range(count):
        row = 0
        for r in range(1, rows):
            if score_maxima[r] > score_maxima[row]:
                row = r
        if score_maxima[row] <= NOWHERE:
            return n
        col = 0
        while score[row, col] != score_maxima[row]:
            col += 1
        cells[n, 0], cells[n, 1] = row, col
        exclude_disc(score, score_maxima, row, col, half_widths)
    return count


@kernel()
def nearest_cell(p_safe, corner, posting, site, min_p_safe, p_safe_maxima, cell):
    """Find the cell nearest to the site with `p_safe` of at least `min_p_safe`.

    Row and column are written to `cell` (2,), and True is returned. If there is no such cell, the
    result is False and `cell` is unchanged. `p_safe_maxima` (rows,) are the row maxima of `p_safe`;
    `corner` and `posting` are those of `score_all`.
    """
    rows, cols = p_safe.shape
    middle = min(max(int(np.floor((site[1] - corner[1]) / posting + 0.5)), 0), rows - 1)
    best = np.inf
    for k in range(2 * rows):
        r = middle + (k + 1) // 2 if k % 2 == 1 else middle - k // 2
        if not 0 <= r < rows:
            continue
        dy = corner[1] + r * posting - site[1]
        if dy * dy > best or p_safe_maxima[r] < min_p_safe:
            continue
        for c in range(cols):
            if p_safe[r, c] >= min_p_safe:
                dx = corner[0] + c * posting - site[0]
                far = dx * dx + dy * dy
                if far < best or (far == best and r < cell[0]):
                    best = far
                    cell[0], cell[1] = r, c
    return best < np.inf


@kernel()
def nearest_cells(p_safe, corner, posting, site, p_safe_levels, count, p_safe_maxima, cells):
    """Append for each of `p_safe_levels` the nearest cell with at least this p_safe.

    `cells` (m, 2) has `count` cells before, as row and column. A level adds no cell if there is
    none, or if its cell is in the list already. Returns the new number of cells. The other
    arguments are those of `nearest_cell`.
    """
    cell = np.empty(2, np.int64)
    for k in range(len(p_safe_levels)):
        known = not nearest_cell(
            p_safe, corner, posting, site, p_safe_levels[k], p_safe_maxima, cell
        )
        for n in range(count):
            known = known or (cells[n, 0] == cell[0] and cells[n, 1] == cell[1])
        if not known:
            cells[count, 0], cells[count, 1] = cell[0], cell[1]
            count += 1
    return count


@kernel()
def average_cell(p, observed, row, col, sigma):
    """Return p_safe of one cell, averaged over a Gaussian landing dispersion.

    `p` and `observed` are maps (rows, cols); `sigma` is the dispersion per axis, in cells, cut at 3
    sigma. Unobserved cells and cells off the map count as 0.
    """
    if not observed[row, col]:
        return 0.0
    reach = int(3.0 * sigma + 0.5)
    if reach == 0:
        return float(p[row, col])
    weights = np.empty(2 * reach + 1)
    total, out = 0.0, 0.0
    for k in range(2 * reach + 1):
        weights[k] = np.exp(-0.5 * ((k - reach) / sigma) ** 2)
        total += weights[k]
    for r in range(max(row - reach, 0), min(row + reach + 1, p.shape[0])):
        line = 0.0
        for c in range(max(col - reach, 0), min(col + reach + 1, p.shape[1])):
            if observed[r, c]:
                line += weights[c - col + reach] * p[r, c]
        out += weights[r - row + reach] * line
    return min(out / (total * total), 1.0)
