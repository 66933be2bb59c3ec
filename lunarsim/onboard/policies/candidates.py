"""Select candidate landing sites from a hazard map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lunarsim.core import candidates as core
from lunarsim.grid import Grid
from lunarsim.onboard.guidance.divert_cost import DivertCost
from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.policies.contract import Candidates
from lunarsim.onboard.policies.reachability import ReachabilityMap
from lunarsim.typing import Array, BoolArray, IntArray

# For each of these values of p_safe, the nearest site above the value is also a candidate.
SAFETY_LEVELS = (0.99, 0.95, 0.8, 0.5)


def proposed_cells(
    aim: FloatMap, grid: Grid, site: Array, count: int, separation: float
) -> tuple[IntArray, list[str]]:
    """Select the safest cells, and the nearest cell at each safety level.

    For each level of `SAFETY_LEVELS`, the cell nearest to the current site with at least this
    probability is added, if there is one and it is not selected yet. Fewer than `count` safest
    cells are returned if no others have a positive probability. Of equally safe cells, the nearer
    one is preferred.

    Parameters
    ----------
    aim
        Probability of a safe landing when aiming at each cell (rows, cols).
    grid
        Grid of the cells.
    site
        Current site (3,), m.
    count
        Maximum number of safest cells.
    separation
        Minimum distance between two of the safest cells, m.

    Returns
    -------
    cells : IntArray
        Row and column of each cell (n, 2), the safest first.
    rules : list of str
        Rule of each cell: "safest" or "nearest at LEVEL".
    """
    aim = np.where(aim > 0.0, aim, np.float32(0.0))
    corner = np.array([grid.x[0], grid.y[0]])
    cells = np.empty((count + len(SAFETY_LEVELS), 2), np.int64)
    score, row_maxima = np.empty_like(aim), np.empty(len(aim), np.float32)
    place = np.asarray(site, dtype=np.float64)
    found = core.best_cells(
        aim, corner, grid.posting, place, count, separation, score, row_maxima, cells
    )
    rules = ["safest"] * found
    for level in SAFETY_LEVELS:
        found = core.nearest_cells(
            aim, corner, grid.posting, place, np.array([level], np.float32), found, row_maxima,
            cells,
        )  # fmt: skip
        rules += [f"nearest at {level}"] * (found - len(rules))
    return cells[:found], rules


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
    reach: ReachabilityMap | None = None,
) -> Candidates:
    """Return candidate landing sites from a hazard map, with the cost of each.

    Candidates are the `count` safest eligible cells at least `separation` metres apart, the nearest
    eligible cell at each of four levels of safety, and the sites ranked by the mapper. If the
    safest site is out of reach, other reachable sites (if there are any) replace all unreachable
    ones.

    Parameters
    ----------
    hazard_map
        Hazard map.
    aim
        Probability of landing safely when aiming at each cell (rows, cols), from
        `HazardMap.dispersed_p_safe`.
    site
        Current site (3,), local frame, m.
    cost_of
        Function that returns the cost of flying to sites (n, 3).
    count
        Number of sites selected by safety.
    separation
        Minimum distance between the sites selected by safety, m.
    miss_of
        Function that returns the expected touchdown error (n,), m, for the time needed to reach
        each site (n,), s. None: the error used for `aim` applies to all sites.
    mapper
        Name of the mapper, for the sources "MAPPER: safest", "MAPPER: nearest at 0.99" and "MAPPER:
        ranked".
    scoreboard
        Sites ranked by the mapper.
    reach
        Map of the cells within reach.
    """
    grid, rules = hazard_map.grid, (site, count, separation, mapper)
    position, source = _proposed_sites(hazard_map, aim, *rules)
    ranked, own = _eligible_ranked(hazard_map, scoreboard)
    position, score = np.vstack((position, ranked)), np.append(np.full(len(position), np.nan), own)
    source += [f"{mapper}: ranked"] * len(own)
    cost = cost_of(position)
    if reach is not None and _is_safest_unreachable(aim[grid.cell(position[:, :2])], cost.feasible):
        reachable = _proposed_sites(
            hazard_map, np.where(reach.at(grid.centres()), aim, np.float32(0.0)), *rules
        )
        position, score, source = _replace_unreachable(
            (position, score, source), cost.feasible, reachable
        )
        cost = cost_of(position)
    p_safe = aim[grid.cell(position[:, :2])].astype(np.float64)
    if miss_of is not None:
        p_safe = hazard_map.dispersed_p_safe_at(position[:, :2], miss_of(cost.time_to_go))
    order = np.argsort(-p_safe, kind="stable")
    position = position[order]
    return Candidates(
        position, p_safe[order], np.hypot(*(position[:, :2] - site[:2]).T), cost.propellant[order],
        hazard_map.value_at(position[:, :2]), score[order], tuple(source[i] for i in order),
    )  # fmt: skip


def _is_safest_unreachable(aim: FloatMap, feasible: BoolArray) -> bool:
    """Return whether an unreachable site is safer than all reachable ones.

    `aim` is the probability of safe terrain at each site (n,); `feasible` marks reachable sites.
    The result is False if a reachable site has a probability of at least 0.99.
    """
    best = float(np.max(aim[feasible], initial=0.0))
    return best < SAFETY_LEVELS[0] and best < float(np.max(aim[~feasible], initial=0.0))


def _replace_unreachable(
    sites: tuple[Array, Array, list[str]], feasible: BoolArray,
    more: tuple[Array, list[str]],
) -> tuple[Array, Array, list[str]]:  # fmt: skip
    """Return sites with the unreachable ones replaced by newly found reachable sites.

    `sites` contains positions (n, 3), m, scores (n,) and sources; `feasible` (n,) marks reachable
    sites. `more` contains positions and sources of the new sites, whose scores are NaN. Without new
    sites, `sites` is returned unchanged.
    """
    (position, score, source), (found, found_source) = sites, more
    kept = np.flatnonzero(feasible)
    new = ~(found[:, None, :2] == position[None, kept, :2]).all(axis=2).any(axis=1)
    if not new.any():
        return sites
    return (
        np.vstack((position[kept], found[new])),
        np.append(score[kept], np.full(int(new.sum()), np.nan)),
        [source[i] for i in kept] + [found_source[i] for i in np.flatnonzero(new)],
    )


def _proposed_sites(
    hazard_map: HazardMap, aim: FloatMap, site: Array, count: int, separation: float, mapper: str
) -> tuple[Array, list[str]]:
    """Return the safest and the nearest safe sites (n, 3), m, and the source of each.

    A source is "MAPPER: RULE", with the rules of `proposed_cells`. `aim` (rows, cols) is the
    probability of safe terrain at each cell; `site` is the current site (3,), m; `count` and
    `separation` (m) are those of the safest sites. Cells that the mission excludes are not
    selected.
    """
    grid = hazard_map.grid
    if hazard_map.eligible is not None:
        aim = np.where(hazard_map.eligible, aim, np.float32(0.0))
    cells, rules = proposed_cells(aim, grid, site, count, separation)
    return _terrain_positions(hazard_map, cells, site), [f"{mapper}: {rule}" for rule in rules]


def _eligible_ranked(hazard_map: HazardMap, scoreboard: Scoreboard | None) -> tuple[Array, Array]:
    """Return the mapper's ranked sites that the mission allows, and their scores.

    Positions are (n, 3), m; scores are (n,). Without a scoreboard, n is 0.
    """
    if scoreboard is None:
        return np.zeros((0, 3)), np.zeros(0)
    is_eligible = hazard_map.eligible_at(scoreboard.position[:, :2])
    return scoreboard.position[is_eligible], scoreboard.score[is_eligible]


def _terrain_positions(hazard_map: HazardMap, cells: IntArray, site: Array) -> Array:
    """Return the centres of cells (n, 2) as positions (n, 3), m, at mapped height.

    Where the map has no height, the height of `site` (3,) is used.
    """
    xy = hazard_map.grid.centre_of(cells[:, 0], cells[:, 1])
    if hazard_map.elevation is None:
        return np.column_stack((xy, np.full(len(cells), site[2])))
    z = hazard_map.elevation[cells[:, 0], cells[:, 1]].astype(np.float64)
    return np.column_stack((xy, np.where(np.isfinite(z), z, site[2])))
