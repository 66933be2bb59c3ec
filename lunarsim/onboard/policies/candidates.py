"""Candidate landing sites from a hazard map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.guidance.divert import DivertCost
from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.policies.contract import Candidates
from lunarsim.onboard.policies.reach import Reach

Array = NDArray[np.float64]

# Besides the safest sites, the nearest ones at least this safe.
_LEVELS = (0.99, 0.95, 0.8, 0.5)
# Between equally safe sites the nearer wins: the share of p_safe that 100 m of distance cost. A
# share, since a map that leaves all ground in doubt still orders it, by thousandths.
_DISTANCE_PRICE = 1e-3


def best_cells(
    aim: FloatMap, distance: Array, posting: float, count: int, separation: float
) -> NDArray[np.int64]:
    """Return up to `count` cells (n, 2) of greatest aim, no two closer than `separation` (m)."""
    price = np.float32(_DISTANCE_PRICE / 100.0) * distance.astype(np.float32)
    score = aim * (np.float32(1.0) - price)
    score[~(aim > 0.0)] = -np.inf
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
    miss_of: Callable[[Array], Array] | None = None,
    mapper: str = "",
    scoreboard: Scoreboard | None = None,
    reach: Reach | None = None,
) -> Candidates:
    """Return the sites that a policy may choose from, and what each costs to reach.

    They are the `count` safest eligible cells at least `separation` metres apart, the nearest
    eligible cell at each of a few levels of safety, and the sites that the mapper has ranked. Where
    the safest is out of reach, all that are give way to others in reach, if there are any.

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
    miss_of
        Returns the expected miss of sites (n,), m, by the time that it takes to reach them (n,), s,
        see `expected_miss`. Left out: that for which `aim` was made, for all.
    mapper
        Its name, for the sources: "MAPPER: safest", "MAPPER: nearest at 0.99", "MAPPER: ranked".
    scoreboard
        Sites that it has ranked.
    reach
        Where the lander can still land.
    """
    grid, rules = hazard_map.grid, (site, count, separation, mapper)
    position, source = _sites(hazard_map, aim, *rules)
    ranked, own = _ranked(hazard_map, scoreboard)
    position, score = np.vstack((position, ranked)), np.append(np.full(len(position), np.nan), own)
    source += [f"{mapper}: ranked"] * len(own)
    cost = cost_of(position)
    if reach is not None and _beaten(aim[grid.cell(position[:, :2])], cost.feasible):
        near = _sites(hazard_map, np.where(reach.at(grid.centres()), aim, np.float32(0.0)), *rules)
        position, score, source = _in_their_stead((position, score, source), cost.feasible, near)
        cost = cost_of(position)
    p_safe = aim[grid.cell(position[:, :2])].astype(np.float64)
    if miss_of is not None:
        p_safe = hazard_map.dispersed_at(position[:, :2], miss_of(cost.time_to_go))
    order = np.argsort(-p_safe, kind="stable")
    position = position[order]
    return Candidates(
        position, p_safe[order], np.hypot(*(position[:, :2] - site[:2]).T), cost.propellant[order],
        hazard_map.value_at(position[:, :2]), score[order], tuple(source[i] for i in order),
    )  # fmt: skip


def _beaten(aim: FloatMap, feasible: NDArray[np.bool_]) -> bool:
    """Tell whether of sites (n,) one out of reach is safer than all in reach, which leave room."""
    best = float(np.max(aim[feasible], initial=0.0))
    return best < _LEVELS[0] and best < float(np.max(aim[~feasible], initial=0.0))


def _in_their_stead(
    sites: tuple[Array, Array, list[str]], feasible: NDArray[np.bool_],
    more: tuple[Array, list[str]],
) -> tuple[Array, Array, list[str]]:  # fmt: skip
    """Return sites, scores and sources with others for those out of reach, if there are any."""
    (position, score, source), (found, told) = sites, more
    kept = np.flatnonzero(feasible)
    new = ~(found[:, None, :2] == position[None, kept, :2]).all(axis=2).any(axis=1)
    if not new.any():
        return sites
    return (
        np.vstack((position[kept], found[new])),
        np.append(score[kept], np.full(int(new.sum()), np.nan)),
        [source[i] for i in kept] + [told[i] for i in np.flatnonzero(new)],
    )


def _sites(
    hazard_map: HazardMap, aim: FloatMap, site: Array, count: int, separation: float, mapper: str
) -> tuple[Array, list[str]]:
    """Return the sites that a map proposes by their aim (n, 3), and by which rule."""
    grid = hazard_map.grid
    if hazard_map.eligible is not None:
        aim = np.where(hazard_map.eligible, aim, np.float32(0.0))
    distance = np.hypot(grid.x[None, :] - site[0], grid.y[:, None] - site[1])
    cells, source = _proposed(aim, distance, grid.posting, count, separation, mapper)
    return _on_ground(hazard_map, cells, site), source


def _proposed(
    aim: FloatMap, distance: Array, posting: float, count: int, separation: float, mapper: str
) -> tuple[NDArray[np.int64], list[str]]:
    """Return the safest cells and the nearest at each level (n, 2), and who proposed them."""
    cells = best_cells(aim, distance, posting, count, separation)
    source = [f"{mapper}: safest"] * len(cells)
    for level in _LEVELS:
        good = aim >= level
        if good.any():
            nearest = np.unravel_index(int(np.argmin(np.where(good, distance, np.inf))), aim.shape)
            if not (cells == nearest).all(axis=1).any():
                cells = np.concatenate((cells, np.array([nearest], dtype=np.int64)))
                source.append(f"{mapper}: nearest at {level}")
    return cells, source


def _ranked(hazard_map: HazardMap, scoreboard: Scoreboard | None) -> tuple[Array, Array]:
    """Return ranked sites that the mission lets the lander land on (n, 3), and their scores."""
    if scoreboard is None:
        return np.zeros((0, 3)), np.zeros(0)
    good = hazard_map.eligible_at(scoreboard.position[:, :2])
    return scoreboard.position[good], scoreboard.score[good]


def _on_ground(hazard_map: HazardMap, cells: NDArray[np.int64], site: Array) -> Array:
    """Return the centres of cells (n, 2) on the mapped ground (n, 3), at the site's height else."""
    xy = hazard_map.grid.centre_of(cells[:, 0], cells[:, 1])
    if hazard_map.elevation is None:
        return np.column_stack((xy, np.full(len(cells), site[2])))
    z = hazard_map.elevation[cells[:, 0], cells[:, 1]].astype(np.float64)
    return np.column_stack((xy, np.where(np.isfinite(z), z, site[2])))
