# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for reachable sites that replace candidates out of reach.

Reachability is computed on a coarser grid over the map (the reach grid), in tiles of 4 x 4 cells
and only where candidates are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.core.candidates import (
    NOWHERE,
    disc_half_widths,
    exclude_disc,
    nearest_cell,
    row_max,
    score_all,
)
from lunarsim.core.path_cost import GRAVITY, MASS
from lunarsim_envs.sites._beyond_kernels import is_unreachable, path_coefficients
from lunarsim_envs.sites._flight_kernels import GuidanceParams, compute_divert_costs

# Maximum cells per side, as in `reach.Reach`; cells per side of a tile; tiles per side of a block.
_SIDE, _TILE, _BLOCK = 100, 4, 4


@kernel()
def is_safest_unreachable(p_safe, cells, cost, count, p_safe_enough):
    """Return whether an unreachable candidate is safer than all reachable ones.

    `p_safe` is (rows, cols); `cells` (m, 2) and `cost` (m, ...) are `count` candidates, with
    infinite cost if unreachable. The result is false if a reachable one has p_safe of at least
    `p_safe_enough`.
    """
    best_reachable, best_unreachable = 0.0, 0.0
    for n in range(count):
        p = p_safe[cells[n, 0], cells[n, 1]]
        if np.isfinite(cost[n, 0]):
            best_reachable = max(best_reachable, p)
        else:
            best_unreachable = max(best_unreachable, p)
    return best_reachable < p_safe_enough and best_reachable < best_unreachable


@kernel()
def _reach_grid(rows, cols, corner, posting, out):
    """Compute the reach grid, on which reachability over a map is computed.

    It covers the map with at most 100 cells per side. Writes west, south, grid spacing (m), rows
    and columns to `out` (5,).
    """
    ratio = max(1.0, max(rows, cols) / _SIDE)
    side = posting * ratio
    out[2] = side
    out[3], out[4] = np.ceil(rows / ratio - 1e-9), np.ceil(cols / ratio - 1e-9)
    for axis, count in ((0, cols), (1, rows)):
        low = corner[axis] - 0.5 * posting
        high = corner[axis] + (count - 0.5) * posting
        out[axis] = 0.5 * (low + high) - 0.5 * (out[4 - axis] - 1.0) * side


class ReachMap(NamedTuple):
    """A map (corner, cell size, heights), its reach grid (5,) and the current site.

    Reachability is computed on the reach grid, which is coarser than the map. `grid_row` (rows,),
    `grid_col` (cols,): reach-grid indices of the rows and columns of the map.
    """

    grid: np.ndarray
    corner: np.ndarray
    posting: float
    height: np.ndarray
    site: np.ndarray
    grid_row: np.ndarray
    grid_col: np.ndarray


class ReachLander(NamedTuple):
    """Lander for which reachability is computed: state (2, 3), mass and guidance law.

    `state` is position (m) and velocity (m/s), `mass` in kg; `paths` is from `path_coefficients`;
    `speed` is the norm of the velocity, `max_acceleration` (m/s^2) bounds the lander's
    acceleration, and `params` are the guidance parameters at this mass.
    """

    state: np.ndarray
    mass: float
    law: GuidanceParams
    paths: np.ndarray
    params: np.ndarray
    speed: float
    max_acceleration: float


@kernel()
def reach_lander(state, mass, law):
    """Return the `ReachLander` of a position and velocity (2, 3) and a mass, kg."""
    paths, params = np.zeros((len(law.paths.coarse_table), 9)), law.paths.params.copy()
    path_coefficients(state, law, paths)
    params[MASS] = mass
    speed = np.sqrt(state[1, 0] ** 2 + state[1, 1] ** 2 + state[1, 2] ** 2)
    return ReachLander(
        state, mass, law, paths, params, speed, law.paths.mass_limits[0] + params[GRAVITY]
    )


@kernel(inner=True)
def _square_cell_position(k, row, col, side, reach_map, site):
    """Compute the position of one cell in a square of the reach grid, `site` (3,), m.

    The reach grid is the coarser grid over the map on which reachability is computed. The square
    has `side` cells per side from (row, col); `k` numbers its cells row by row.
    """
    grid, corner, posting = reach_map.grid, reach_map.corner, reach_map.posting
    rows, cols = reach_map.height.shape
    x = grid[0] + min(col + k % side, int(grid[4]) - 1) * grid[2]
    y = grid[1] + min(row + k // side, int(grid[3]) - 1) * grid[2]
    r = int(np.floor((y - corner[1]) / posting + 0.5))
    c = int(np.floor((x - corner[0]) / posting + 0.5))
    site[0], site[1], site[2] = x, y, reach_map.site[2]
    if 0 <= r < rows and 0 <= c < cols and np.isfinite(reach_map.height[r, c]):
        site[2] = reach_map.height[r, c]


@kernel(inner=True)
def _is_square_unreachable(row, col, side, reach_map, lander):
    """Return whether it is proven that a square of the reach grid is out of reach.

    The reach grid is the coarser grid over the map on which reachability is computed. The square
    has `side` cells per side from (row, col). False means that nothing is proven.
    """
    low, high, site = np.full(3, np.inf), np.full(3, -np.inf), np.empty(3)
    for k in range(side * side):
        _square_cell_position(k, row, col, side, reach_map, site)
        for axis in range(3):
            low[axis] = min(low[axis], site[axis] + lander.law.end_offset[axis])
            high[axis] = max(high[axis], site[axis] + lander.law.end_offset[axis])
    paths, state, law = lander.paths, lander.state, lander.law
    return is_unreachable(
        paths, state, low, high, lander.speed, lander.max_acceleration, law, lander.params
    )


@kernel()
def _survey_tile(row, col, reach_map, lander, out):
    """Compute which cells of a tile of the reach grid are reachable, into `out` (16,).

    The reach grid is the coarser grid over the map on which reachability is computed. The tile has
    4 x 4 cells from (row, col).
    """
    sites, cost = np.empty((_TILE * _TILE, 3)), np.empty((_TILE * _TILE, 4))
    for k in range(_TILE * _TILE):
        _square_cell_position(k, row, col, _TILE, reach_map, sites[k])
    compute_divert_costs(lander.state, lander.mass, sites, lander.law, cost)
    for k in range(_TILE * _TILE):
        out[k] = np.isfinite(cost[k, 0])


@kernel(inner=True)
def _grid_indices(count, corner, posting, grid_corner, grid_spacing, out):
    """Write the reach-grid index of each map row or column to `out` (count,).

    `corner` and `posting` are position and spacing of map cells, `grid_corner` and `grid_spacing`
    those of the reach grid, m.
    """
    for c in range(count):
        out[c] = int(np.floor((corner + c * posting - grid_corner) / grid_spacing + 0.5))


@kernel()
def _remove_unreachable(row, col, side, reach_map, score, masked, score_maxima, reachable):
    """Remove unreachable map cells in a square of the reach grid from the candidates.

    The reach grid is the coarser grid over the map on which reachability is computed. The square
    has `side` of its cells per side from (row, col). `reachable` (side * side,) are the flags of
    these cells by row; an empty array means that none is reachable. In unreachable map cells,
    p_safe `masked` (rows, cols) becomes 0 and `score` (rows, cols) `NOWHERE`; the row maxima
    `score_maxima` (rows,) are updated.
    """
    rows, cols = masked.shape
    ratio = reach_map.grid[2] / reach_map.posting
    for r in range(max(int(row * ratio) - 2, 0), min(int((row + side) * ratio) + 3, rows)):
        row_offset = reach_map.grid_row[r] - row
        if not 0 <= row_offset < side:
            continue
        for c in range(max(int(col * ratio) - 2, 0), min(int((col + side) * ratio) + 3, cols)):
            col_offset = reach_map.grid_col[c] - col
            if 0 <= col_offset < side and (
                len(reachable) == 0 or not reachable[row_offset * side + col_offset]
            ):
                masked[r, c], score[r, c] = 0.0, NOWHERE
        score_maxima[r] = row_max(score, r)


@kernel()
def _evaluate_around(r, c, reach_map, tiles, blocks, lander, masked, score, score_maxima):
    """Compute reachability around map cell (r, c), unless it is already known.

    Removes unreachable cells from the maps `masked` (p_safe) and `score`. `tiles` and `blocks` mark
    what has been evaluated. Returns false if the reachability was known; then nothing changes.
    """
    row, col = reach_map.grid_row[r] // _TILE, reach_map.grid_col[c] // _TILE
    if tiles[row, col]:
        return False
    up, right = row // _BLOCK, col // _BLOCK
    none = np.empty(0, np.bool_)
    if not blocks[up, right]:
        blocks[up, right] = True
        side = _BLOCK * _TILE
        if _is_square_unreachable(up * side, right * side, side, reach_map, lander):
            south, west = up * _BLOCK, right * _BLOCK
            tiles[south : south + _BLOCK, west : west + _BLOCK] = True
            _remove_unreachable(
                up * side, right * side, side, reach_map, score, masked, score_maxima, none
            )
            return True
    tiles[row, col] = True
    if _is_square_unreachable(row * _TILE, col * _TILE, _TILE, reach_map, lander):
        _remove_unreachable(
            row * _TILE, col * _TILE, _TILE, reach_map, score, masked, score_maxima, none
        )
        return True
    reachable = np.empty(_TILE * _TILE, np.bool_)
    _survey_tile(row * _TILE, col * _TILE, reach_map, lander, reachable)
    _remove_unreachable(
        row * _TILE, col * _TILE, _TILE, reach_map, score, masked, score_maxima, reachable
    )
    return True


@kernel()
def select_reachable(
    p_safe, corner, posting, height, site, state, mass, law, count, separation, p_safe_levels,
    masked, score, cells,
):  # fmt: skip
    """Select reachable candidate cells from a map, into `cells` (m, 2).

    Candidates are up to `count` cells with the best `p_safe`, `separation` (m) apart, and for each
    of `p_safe_levels` the nearest cell with at least this p_safe. Returns their number. `masked`
    and `score` are scratch.
    """
    rows, cols = p_safe.shape
    grid, score_maxima, p_safe_maxima = (
        np.empty(5),
        np.empty(rows, np.float32),
        np.empty(rows, np.float32),
    )
    _reach_grid(rows, cols, corner, posting, grid)
    row_of, col_of = np.empty(rows, np.int64), np.empty(cols, np.int64)
    _grid_indices(rows, corner[1], posting, grid[1], grid[2], row_of)
    _grid_indices(cols, corner[0], posting, grid[0], grid[2], col_of)
    reach_map = ReachMap(grid, corner, posting, height, site, row_of, col_of)
    lander = reach_lander(state, mass, law)
    tiles = np.zeros((_SIDE // _TILE + 1, _SIDE // _TILE + 1), np.bool_)
    blocks = np.zeros((len(tiles) // _BLOCK + 1, len(tiles) // _BLOCK + 1), np.bool_)
    for r in range(rows):
        for c in range(cols):
            masked[r, c] = p_safe[r, c]
    score_all(p_safe, corner, posting, site, score, score_maxima, p_safe_maxima)
    half_widths = np.empty(int(np.ceil(separation / posting)) + 1, np.int64)
    disc_half_widths(separation, posting, half_widths)
    n = 0
    while n < count:
        row = np.int64(0)  # Numba would give a plain zero another type
        for r in range(1, rows):
            if score_maxima[r] > score_maxima[row]:
                row = r
        if score_maxima[row] <= NOWHERE:
            break
        col = 0
        while score[row, col] != score_maxima[row]:
            col += 1
        if _evaluate_around(
            row, col, reach_map, tiles, blocks, lander, masked, score, score_maxima
        ):
            continue
        cells[n, 0], cells[n, 1] = row, col
        n += 1
        exclude_disc(score, score_maxima, row, col, half_widths)
    cell = np.empty(2, np.int64)
    for k in range(len(p_safe_levels)):
        there = nearest_cell(masked, corner, posting, site, p_safe_levels[k], p_safe_maxima, cell)
        while there and _evaluate_around(
            cell[0], cell[1], reach_map, tiles, blocks, lander, masked, score, score_maxima
        ):
            there = nearest_cell(
                masked, corner, posting, site, p_safe_levels[k], p_safe_maxima, cell
            )
        for m in range(n):
            there = there and not (cells[m, 0] == cell[0] and cells[m, 1] == cell[1])
        if there:
            cells[n, 0], cells[n, 1] = cell[0], cell[1]
            n += 1
    return n


@kernel()
def replace_unreachable(cells, cost, count, reachable, reachable_count):
    """Replace unreachable candidates in `cells` by reachable cells; return the count.

    `cells` (m, 2) has `count` candidates with `cost` (inf if unreachable); `reachable` has
    `reachable_count` cells. If the candidates already include all of these, nothing changes.
    """
    kept = 0
    new = np.ones(reachable_count, np.bool_)
    any_new = False
    for k in range(reachable_count):
        for n in range(count):
            if np.isfinite(cost[n, 0]):
                same = cells[n, 0] == reachable[k, 0] and cells[n, 1] == reachable[k, 1]
                new[k] = new[k] and not same
        any_new = any_new or new[k]
    if not any_new:
        return count
    for n in range(count):
        if np.isfinite(cost[n, 0]):
            cells[kept, 0], cells[kept, 1] = cells[n, 0], cells[n, 1]
            kept += 1
    for k in range(reachable_count):
        if new[k]:
            cells[kept, 0], cells[kept, 1] = reachable[k, 0], reachable[k, 1]
            kept += 1
    return kept
