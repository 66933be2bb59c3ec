# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for reachable sites that replace candidates out of reach.

Reachability is computed on a coarser grid over the map (the reach grid), in tiles of 4 x 4 cells
and only where candidates are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import GRAVITY, MASS
from lunarsim_envs.sites._beyond_kernels import beyond, ways_of
from lunarsim_envs.sites._cell_kernels import (
    NOWHERE,
    clear,
    halves_of,
    nearest,
    row_max,
    score_all,
)
from lunarsim_envs.sites._flight_kernels import Law, reach

# Maximum cells per side, as in `reach.Reach`; cells per side of a tile; tiles per side of a block.
_SIDE, _TILE, _BLOCK = 100, 4, 4


@kernel()
def beaten(aim, cells, cost, count, enough):
    """Return whether an unreachable candidate is safer than all reachable ones.

    `aim` (rows, cols) is p_safe; `cells` (m, 2) and `cost` (m, ...) are `count` candidates, with
    infinite cost if unreachable. False if a reachable one has p_safe of at least `enough`.
    """
    best, lost = 0.0, 0.0
    for n in range(count):
        p = aim[cells[n, 0], cells[n, 1]]
        if np.isfinite(cost[n, 0]):
            best = max(best, p)
        else:
            lost = max(lost, p)
    return best < enough and best < lost


@kernel()
def _grid(rows, cols, corner, posting, out):
    """Compute the reach grid that covers a map, with at most 100 cells per side.

    Writes west, south, grid spacing (m), rows and columns to `out` (5,).
    """
    ratio = max(1.0, max(rows, cols) / _SIDE)
    side = posting * ratio
    out[2] = side
    out[3], out[4] = np.ceil(rows / ratio - 1e-9), np.ceil(cols / ratio - 1e-9)
    for axis, count in ((0, cols), (1, rows)):
        low = corner[axis] - 0.5 * posting
        high = corner[axis] + (count - 0.5) * posting
        out[axis] = 0.5 * (low + high) - 0.5 * (out[4 - axis] - 1.0) * side


class Place(NamedTuple):
    """A map (corner, cell size, heights), its reach grid (5,) and the current site.

    `row` (rows,), `col` (cols,): reach-grid indices of the rows and columns of the map.
    """

    grid: np.ndarray
    corner: np.ndarray
    posting: float
    height: np.ndarray
    site: np.ndarray
    row: np.ndarray
    col: np.ndarray


class Flying(NamedTuple):
    """Lander for which reachability is computed: state (2, 3), mass and guidance law.

    `state` is position and velocity; `ways` are path coefficients from `ways_of`; `speed` (m/s),
    `most` (m/s^2) and `figures` are arguments of `beyond`.
    """

    state: np.ndarray
    mass: float
    law: Law
    ways: np.ndarray
    figures: np.ndarray
    speed: float
    most: float


@kernel()
def flying(state, mass, law):
    """Return a `Flying` from position and velocity (2, 3), mass (kg) and guidance law."""
    ways, figures = np.zeros((len(law.rough), 9)), law.figures.copy()
    ways_of(state, law, ways)
    figures[MASS] = mass
    speed = np.sqrt(state[1, 0] ** 2 + state[1, 1] ** 2 + state[1, 2] ** 2)
    return Flying(state, mass, law, ways, figures, speed, law.bounds[0] + figures[GRAVITY])


@kernel(inner=True)
def _at(k, row, col, side, place, site):
    """Compute the position of one cell in a square of the reach grid (3,), m.

    The square has `side` cells per side from (row, col); `k` numbers its cells row by row.
    """
    grid, corner, posting = place.grid, place.corner, place.posting
    rows, cols = place.height.shape
    x = grid[0] + min(col + k % side, int(grid[4]) - 1) * grid[2]
    y = grid[1] + min(row + k // side, int(grid[3]) - 1) * grid[2]
    r = int(np.floor((y - corner[1]) / posting + 0.5))
    c = int(np.floor((x - corner[0]) / posting + 0.5))
    site[0], site[1], site[2] = x, y, place.site[2]
    if 0 <= r < rows and 0 <= c < cols and np.isfinite(place.height[r, c]):
        site[2] = place.height[r, c]


@kernel(inner=True)
def _lost(row, col, side, place, lander):
    """Return whether it is proven that a square of the reach grid is out of reach.

    The square has `side` cells per side from (row, col); `lander` is a `Flying`.
    """
    low, high, site = np.full(3, np.inf), np.full(3, -np.inf), np.empty(3)
    for k in range(side * side):
        _at(k, row, col, side, place, site)
        for axis in range(3):
            low[axis] = min(low[axis], site[axis] + lander.law.above[axis])
            high[axis] = max(high[axis], site[axis] + lander.law.above[axis])
    ways, state, law = lander.ways, lander.state, lander.law
    return beyond(ways, state, low, high, lander.speed, lander.most, law, lander.figures)


@kernel()
def _survey(row, col, place, lander, out):
    """Compute which cells of a tile (4 x 4 cells from row, col) are reachable (16,)."""
    sites, cost = np.empty((_TILE * _TILE, 3)), np.empty((_TILE * _TILE, 4))
    for k in range(_TILE * _TILE):
        _at(k, row, col, _TILE, place, sites[k])
    reach(lander.state, lander.mass, sites, lander.law, cost)
    for k in range(_TILE * _TILE):
        out[k] = np.isfinite(cost[k, 0])


@kernel(inner=True)
def _columns(count, corner, posting, low, side, out):
    """Write the reach-grid index of each map row or column to `out` (count,).

    `corner` and `posting` are position and spacing of map cells, `low` and `side` those of the
    reach grid, m.
    """
    for c in range(count):
        out[c] = int(np.floor((corner + c * posting - low) / side + 0.5))


@kernel()
def _open(row, col, side, place, score, masked, most, reached):
    """Remove unreachable map cells in a square of the reach grid from the candidates.

    `reached` are the flags of the cells in the square; an empty array means that none is reachable.
    Updates p_safe `masked`, `score` (rows, cols) and the row maxima `most` (rows,).
    """
    rows, cols = masked.shape
    ratio = place.grid[2] / place.posting
    for r in range(max(int(row * ratio) - 2, 0), min(int((row + side) * ratio) + 3, rows)):
        far = place.row[r] - row
        if not 0 <= far < side:
            continue
        for c in range(max(int(col * ratio) - 2, 0), min(int((col + side) * ratio) + 3, cols)):
            wide = place.col[c] - col
            if 0 <= wide < side and (len(reached) == 0 or not reached[far * side + wide]):
                masked[r, c], score[r, c] = 0.0, NOWHERE
        most[r] = row_max(score, r)


@kernel()
def _looked(r, c, place, tiles, blocks, lander, masked, score, most):
    """Compute reachability around map cell (r, c), unless it is known.

    `tiles` and `blocks` mark what was evaluated. Returns whether the candidates may have changed.
    """
    row, col = place.row[r] // _TILE, place.col[c] // _TILE
    if tiles[row, col]:
        return False
    up, right = row // _BLOCK, col // _BLOCK
    none = np.empty(0, np.bool_)
    if not blocks[up, right]:
        blocks[up, right] = True
        side = _BLOCK * _TILE
        if _lost(up * side, right * side, side, place, lander):
            south, west = up * _BLOCK, right * _BLOCK
            tiles[south : south + _BLOCK, west : west + _BLOCK] = True
            _open(up * side, right * side, side, place, score, masked, most, none)
            return True
    tiles[row, col] = True
    if _lost(row * _TILE, col * _TILE, _TILE, place, lander):
        _open(row * _TILE, col * _TILE, _TILE, place, score, masked, most, none)
        return True
    reached = np.empty(_TILE * _TILE, np.bool_)
    _survey(row * _TILE, col * _TILE, place, lander, reached)
    _open(row * _TILE, col * _TILE, _TILE, place, score, masked, most, reached)
    return True


@kernel()
def within(
    aim, corner, posting, height, site, state, mass, law, count, separation, levels, masked, score,
    cells,
):  # fmt: skip
    """Select reachable candidate cells from a map, into `cells` (m, 2).

    Candidates are up to `count` cells with the best p_safe `aim`, `separation` (m) apart, and the
    nearest cells at each of `levels`. Returns their number. `masked` and `score` are scratch.
    """
    rows, cols = aim.shape
    grid, most, highest = np.empty(5), np.empty(rows, np.float32), np.empty(rows, np.float32)
    _grid(rows, cols, corner, posting, grid)
    row_of, col_of = np.empty(rows, np.int64), np.empty(cols, np.int64)
    _columns(rows, corner[1], posting, grid[1], grid[2], row_of)
    _columns(cols, corner[0], posting, grid[0], grid[2], col_of)
    place = Place(grid, corner, posting, height, site, row_of, col_of)
    lander = flying(state, mass, law)
    tiles = np.zeros((_SIDE // _TILE + 1, _SIDE // _TILE + 1), np.bool_)
    blocks = np.zeros((len(tiles) // _BLOCK + 1, len(tiles) // _BLOCK + 1), np.bool_)
    for r in range(rows):
        for c in range(cols):
            masked[r, c] = aim[r, c]
    score_all(aim, corner, posting, site, score, most, highest)
    halves = np.empty(int(np.ceil(separation / posting)) + 1, np.int64)
    halves_of(separation, posting, halves)
    n = 0
    while n < count:
        row = np.int64(0)  # Numba would give a plain zero another type
        for r in range(1, rows):
            if most[r] > most[row]:
                row = r
        if most[row] <= NOWHERE:
            break
        col = 0
        while score[row, col] != most[row]:
            col += 1
        if _looked(row, col, place, tiles, blocks, lander, masked, score, most):
            continue
        cells[n, 0], cells[n, 1] = row, col
        n += 1
        clear(score, most, row, col, halves)
    at = np.empty(2, np.int64)
    for k in range(len(levels)):
        there = nearest(masked, corner, posting, site, levels[k], highest, at)
        while there and _looked(at[0], at[1], place, tiles, blocks, lander, masked, score, most):
            there = nearest(masked, corner, posting, site, levels[k], highest, at)
        for m in range(n):
            there = there and not (cells[m, 0] == at[0] and cells[m, 1] == at[1])
        if there:
            cells[n, 0], cells[n, 1] = at[0], at[1]
            n += 1
    return n


@kernel()
def replace_unreachable(cells, cost, count, more, found):
    """Replace unreachable candidates by reachable cells; return the new number.

    `cells` (m, 2) has `count` candidates with `cost` (inf if unreachable); `more` has `found`
    reachable cells. If all of these are known, nothing changes.
    """
    kept = 0
    new = np.ones(found, np.bool_)
    any_new = False
    for k in range(found):
        for n in range(count):
            if np.isfinite(cost[n, 0]):
                same = cells[n, 0] == more[k, 0] and cells[n, 1] == more[k, 1]
                new[k] = new[k] and not same
        any_new = any_new or new[k]
    if not any_new:
        return count
    for n in range(count):
        if np.isfinite(cost[n, 0]):
            cells[kept, 0], cells[kept, 1] = cells[n, 0], cells[n, 1]
            kept += 1
    for k in range(found):
        if new[k]:
            cells[kept, 0], cells[kept, 1] = more[k, 0], more[k, 1]
            kept += 1
    return kept
