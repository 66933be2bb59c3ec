"""Candidate landing sites from a hazard map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.guidance.divert import DivertCost
from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
from lunarsim.onboard.policies.contract import Candidates

Array = NDArray[np.float64]

# Besides the safest sites, the nearest ones at least this safe.
_LEVELS = (0.99, 0.95, 0.8, 0.5)
# Between equally safe sites the nearer wins: p_safe that 100 m of distance cost.
_DISTANCE_PRICE = 1e-3


def best_cells(
    aim: FloatMap, distance: Array, posting: float, count: int, separation: float
) -> NDArray[np.int64]:
    """Return up to `count` cells (n, 2) of greatest aim, no two closer than `separation` (m)."""
    score = aim - np.float32(_DISTANCE_PRICE / 100.0) * distance.astype(np.float32)
    score[aim <= 0.0] = -np.inf
    reach = int(np.ceil(separation / posting))
    offsets = np.arange(-reach, reach + 1)
    near = np.hypot(offsets[:, None], offsets[None, :]) * posting < separation
    cells = []
    for _ in range(count):
        row, col = (int(v) for v in np.unravel_index(int(np.argmax(score)), score.shape))
        if not np.isfinite(score[row, col]):
            break
        cells.append((row, col))
        r0, c0 = max(row - reach, 0), max(col - reach, 0)
        window = score[r0 : row + reach + 1, c0 : col + reach + 1]
        shape = near[
            r0 - row + reach : r0 - row + reach + window.shape[0],
            c0 - col + reach : c0 - col + reach + window.shape[1],
        ]
        window[shape] = -np.inf
    return np.array(cells, dtype=np.int64).reshape(-1, 2)


def candidate_sites(
    hazard_map: HazardMap,
    aim: FloatMap,
    site: Array,
    cost_of: Callable[[Array], DivertCost],
    *,
    count: int,
    separation: float,
) -> Candidates:
    """Return the sites that a policy may choose from, and what each costs to reach.

    They are the `count` safest cells at least `separation` metres apart, and the nearest cell at
    each of a few levels of safety.

    Parameters
    ----------
    hazard_map
        The map.
    aim
        Probability of landing safely when aiming at each cell: `HazardMap.dispersed`.
    site
        Where the lander is going (3,).
    cost_of
        Returns what it costs to fly to sites (n, 3).
    count, separation
        Number of sites and least distance between them, m.
    """
    grid = hazard_map.grid
    distance = np.hypot(grid.x[None, :] - site[0], grid.y[:, None] - site[1])
    cells = best_cells(aim, distance, grid.posting, count, separation)
    for level in _LEVELS:
        good = aim >= level
        if good.any():
            nearest = np.unravel_index(int(np.argmin(np.where(good, distance, np.inf))), aim.shape)
            if not (cells == nearest).all(axis=1).any():
                cells = np.concatenate((cells, np.array([nearest], dtype=np.int64)))
    p_safe = aim[cells[:, 0], cells[:, 1]].astype(np.float64)
    order = np.argsort(-p_safe, kind="stable")
    cells, p_safe = cells[order], p_safe[order]
    xy = grid.centre_of(cells[:, 0], cells[:, 1])
    if hazard_map.elevation is not None:
        z = hazard_map.elevation[cells[:, 0], cells[:, 1]].astype(np.float64)
        z = np.where(np.isfinite(z), z, site[2])
    else:
        z = np.full(len(cells), site[2])
    position = np.column_stack((xy, z))
    cost = cost_of(position)
    return Candidates(position, p_safe, distance[cells[:, 0], cells[:, 1]], cost.propellant)
