"""Compiled sites in reach that take the place of others out of it.

See `candidates.candidate_sites` and `Reach`: where the safest sites are out of reach, all that are
give way to sites proposed within it. What can be reached is told cell by cell of a grid of at most
a hundred a side; here sixteen of its cells are surveyed at a time, only where a site would lie, and
only where they are not proven to be out of reach together (see `_beyond_kernels`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import GRAVITY, MASS
from lunarsim_envs.sites._beyond_kernels import beyond, ways_of
from lunarsim_envs.sites._cell_kernels import clear, greatest, halves_of, nearest, offsets, scored
from lunarsim_envs.sites._cell_kernels import NOWHERE
from lunarsim_envs.sites._flight_kernels import Law, reach

# Of `reach.Reach`: cells a side at most; a tile has so many a side.
_SIDE, _TILE = 100, 4


@kernel()
def beaten(aim, cells, cost, count, enough):
    """Tell whether a site out of reach is safer than all in it; see `candidates._beaten`."""
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
    """Write west, south, posting, rows and columns of the grid of reach (5,).

    Term by term as `Reach.under` and `Grid` have it: cells on an edge fall to the same side.
    """
    ratio = max(1.0, max(rows, cols) / _SIDE)
    side = posting * ratio
    out[2] = side
    out[3], out[4] = np.ceil(rows / ratio - 1e-9), np.ceil(cols / ratio - 1e-9)
    for axis, count in ((0, cols), (1, rows)):
        low = corner[axis] - 0.5 * posting
        high = corner[axis] + (count - 0.5) * posting
        out[axis] = 0.5 * (low + high) - 0.5 * (out[4 - axis] - 1.0) * side


class Flying(NamedTuple):
    """How a lander flies: state (2, 3), mass, law, and what paths hang on, see `ways_of`.

    `speed`, m/s, and `most`, m/s^2, as `beyond` takes them; `figures`, with its mass.
    """

    state: np.ndarray
    mass: float
    law: Law
    ways: np.ndarray
    figures: np.ndarray
    speed: float
    most: float


@kernel(inner=True)
def flying(state, mass, law):
    """Return how a lander flies."""
    ways, figures = np.zeros((len(law.rough), 9)), law.figures.copy()
    ways_of(state, law, ways)
    figures[MASS] = mass
    speed = np.sqrt(state[1, 0] ** 2 + state[1, 1] ** 2 + state[1, 2] ** 2)
    return Flying(state, mass, law, ways, figures, speed, law.bounds[0] + figures[GRAVITY])


@kernel()
def _survey(row, col, grid, corner, posting, height, site, lander, out):
    """Write what it takes to land in the cells of a tile (16, 4); inf where that is no matter."""
    rows, cols = height.shape
    sites = np.empty((_TILE * _TILE, 3))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for k in range(_TILE * _TILE):
        x = grid[0] + min(col + k % _TILE, int(grid[4]) - 1) * grid[2]
        y = grid[1] + min(row + k // _TILE, int(grid[3]) - 1) * grid[2]
        r = int(np.floor((y - corner[1]) / posting + 0.5))
        c = int(np.floor((x - corner[0]) / posting + 0.5))
        sites[k, 0], sites[k, 1], sites[k, 2] = x, y, site[2]
        if 0 <= r < rows and 0 <= c < cols and np.isfinite(height[r, c]):
            sites[k, 2] = height[r, c]
        for axis in range(3):
            low[axis] = min(low[axis], sites[k, axis] + lander.law.above[axis])
            high[axis] = max(high[axis], sites[k, axis] + lander.law.above[axis])
    ways, state, law = lander.ways, lander.state, lander.law
    if beyond(ways, state, low, high, lander.speed, lander.most, law, lander.figures):
        out[:, 0] = np.inf
    else:
        reach(state, lander.mass, sites, law, out)


@kernel()
def _open(row, col, grid, corner, posting, score, masked, most, cost):
    """Take the cells out of reach in a tile, whose first cell is given, out of a masked aim."""
    rows, cols = masked.shape
    ratio = grid[2] / posting
    for r in range(max(int(row * ratio) - 2, 0), min(int((row + _TILE) * ratio) + 3, rows)):
        far = int(np.floor((corner[1] + r * posting - grid[1]) / grid[2] + 0.5)) - row
        if not 0 <= far < _TILE:
            continue
        for c in range(max(int(col * ratio) - 2, 0), min(int((col + _TILE) * ratio) + 3, cols)):
            wide = int(np.floor((corner[0] + c * posting - grid[0]) / grid[2] + 0.5)) - col
            if 0 <= wide < _TILE and not np.isfinite(cost[far * _TILE + wide, 0]):
                masked[r, c], score[r, c] = 0.0, NOWHERE
        most[r] = greatest(score[r])


@kernel()
def _looked(r, c, place, tiles, lander, masked, score, most):
    """Survey the tile of a cell if nobody has; tell whether it had not been.

    `place`: grid of reach, corner and posting of the map, its heights and the site.
    """
    grid, corner, posting, height, site = place
    row = int(np.floor((corner[1] + r * posting - grid[1]) / grid[2] + 0.5)) // _TILE
    col = int(np.floor((corner[0] + c * posting - grid[0]) / grid[2] + 0.5)) // _TILE
    if tiles[row, col]:
        return False
    tiles[row, col] = True
    cost = np.empty((_TILE * _TILE, 4))
    first, left = row * _TILE, col * _TILE
    _survey(first, left, grid, corner, posting, height, site, lander, cost)
    _open(first, left, grid, corner, posting, score, masked, most, cost)
    return True


@kernel()
def within(
    aim, corner, posting, height, site, state, mass, law, count, separation, levels, masked, score,
    cells,
):  # fmt: skip
    """Write the cells in reach that `candidates._sites` proposes (m, 2), and return how many.

    `masked`, `score` (rows, cols) are written over.
    """
    rows, cols = aim.shape
    grid, most, highest = np.empty(5), np.empty(rows, np.float32), np.empty(rows, np.float32)
    _grid(rows, cols, corner, posting, grid)
    place = grid, corner, posting, height, site
    lander = flying(state, mass, law)
    tiles = np.zeros((_SIDE // _TILE + 1, _SIDE // _TILE + 1), np.bool_)
    offset = np.empty(cols, np.float32)
    offsets(corner[0], posting, site[0], offset)
    for r in range(rows):
        for c in range(cols):
            masked[r, c] = aim[r, c]
        dy = np.float32(corner[1] + r * posting - site[1])
        most[r], highest[r] = scored(masked[r], dy, offset, score[r])
    halves = np.empty(int(np.ceil(separation / posting)) + 1, np.int64)
    halves_of(separation, posting, halves)
    n = 0
    while n < count:
        row = 0
        for r in range(1, rows):
            if most[r] > most[row]:
                row = r
        if most[row] <= NOWHERE:
            break
        col = 0
        while score[row, col] != most[row]:
            col += 1
        if _looked(row, col, place, tiles, lander, masked, score, most):
            continue
        cells[n, 0], cells[n, 1] = row, col
        n += 1
        clear(score, most, row, col, halves)
    at = np.empty(2, np.int64)
    for k in range(len(levels)):
        there = nearest(masked, corner, posting, site, levels[k], highest, at)
        while there and _looked(at[0], at[1], place, tiles, lander, masked, score, most):
            there = nearest(masked, corner, posting, site, levels[k], highest, at)
        for m in range(n):
            there = there and not (cells[m, 0] == at[0] and cells[m, 1] == at[1])
        if there:
            cells[n, 0], cells[n, 1] = at[0], at[1]
            n += 1
    return n


@kernel()
def in_their_stead(cells, cost, count, more, found):
    """Put cells in reach in the place of those out of it, if there are any; return how many."""
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
