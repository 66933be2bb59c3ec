"""Fly over one simulated terrain with each mapper and evaluate all maps.

Flights with the same index have the same terrain, start and noise. The first one runs all mappers
at once and decides with one of them: their maps use the same returns and are directly comparable.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from comparison_rows import MAPPERS
from scipy import ndimage

from lunarsim import (
    Grid,
    HazardMap,
    RandomStreams,
    Scenario,
    Simulation,
    Terrain,
    build_world,
    flight_seed,
)
from lunarsim.api import HazardMapper
from lunarsim.evaluation.flight_metrics import evaluate
from lunarsim.evaluation.reliability import reliability
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper
from lunarsim.rocks.field import RockField
from lunarsim.world import World

SCENARIOS = Path(__file__).resolve().parents[1]
# Maps are compared, not navigation: the position comes from the truth with an error budget.
WITH_FIXES: dict[str, Any] = {
    "sensors": {
        "altimeter": None,
        "velocimeter": None,
        "stars": None,
        "fix": {"kind": "navigation-fix"},
    }
}
# Scenario file and its changes.
WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    "HiRISE, c = 0.2": ("hirise.toml", WITH_FIXES),
    "HiRISE, c = 0.5": ("hirise.toml", {**WITH_FIXES, "terrain": {"relief_scale": 0.5}}),
    # The published results are for terrain without detail below its grid spacing.
    "cratered highland": ("highland.toml", {**WITH_FIXES, "terrain": {"detail_m": 0.0}}),
    "Apollo 15": ("apollo15.toml", WITH_FIXES),
    "hazard field": ("morpheus.toml", {}),
}
# Mapper and policy; the first flight runs all mappers.
WAYS: dict[str, tuple[str, str]] = {
    "Gaussian DEM, calibrated": ("calibrated", "safest"),
    "Gaussian DEM, Eqs. 15-17": ("level", "safest"),
    "quadtree": ("quadtree", "safest"),
    "quadtree, scoreboard": ("quadtree", "scoreboard"),
}
# Ratio of the half side of the quadtree landing zone to that of the lander footprint (its paper).
ZONE = 1.35
STRATA = (
    "level, no rock",
    "sloping, no rock",
    "rock in the footprint",
    "steeper than the limit",
)


@dataclass(frozen=True)
class MapEvaluation:
    """Evaluation of a hazard map against the truth, by terrain class (stratum).

    Attributes
    ----------
    counts
        True safe, false safe, missed and rejected cells (strata, 4).
    claimed
        Cells with a calibrated probability: number, safe cells, sum of squared errors (strata, 3).
    table
        Calibration counts over these cells, all strata together (bins, 3).
    """

    counts: np.ndarray
    claimed: np.ndarray
    table: np.ndarray


def scenario_of(world: str) -> Scenario:
    """Return the scenario of a simulated terrain in `WORLDS`."""
    file, changes = WORLDS[world]
    return Scenario.load(SCENARIOS / file).changed(**changes)


def with_mappers(scenario: Scenario, mappers: tuple[str, ...]) -> Scenario:
    """Return a scenario with other mappers; decisions use the first of them.

    `mappers` are "calibrated" or "level" (Gaussian DEM with calibrated safety, or with Eqs. 15 to
    17 of its paper) or "quadtree".
    """
    name = next(iter(scenario.mappers))
    tables: dict[str, Any] = {m: _mapper_table(scenario, m) for m in mappers}
    if name not in tables:
        tables[name] = None
    return scenario.changed(mappers=tables, decisions={"map": mappers[0]})


def _mapper_table(scenario: Scenario, mapper: str) -> dict[str, Any]:
    """Return the scenario table of a mapper, with the grid of the first mapper."""
    own = next(iter(scenario.mappers.values()))
    table = {"sensor": own.sensor, "size_m": own.size_m, "posting_m": own.posting_m}
    # As often as decisions are made.
    table["interval_s"] = scenario.decisions.interval_s
    if mapper != "quadtree":
        return table | {"kind": "gaussian-dem", "safety": mapper}
    if own.kind == "quadtree":
        return table | {"kind": "quadtree"}
    lander = scenario.vehicle.make()
    sites = {
        "zone_half_side_m": ZONE * (lander.leg_radius + 0.5 * lander.pad_diameter),
        "roughness_limit_m": lander.roughness_limit,
    }
    return table | {"kind": "quadtree", "sites": sites}


class SingleMapperTimer:
    """Measure the computing time of a mapper; `seconds` is the total, s."""

    def __init__(self, mapper: HazardMapper) -> None:
        self.seconds = 0.0
        for name in ("update", "refresh", "terrain_surface", "hazard_map", "scoreboard"):
            setattr(mapper, name, self._timed(getattr(mapper, name)))

    def _timed(self, method: Any) -> Any:
        """Return a method that adds its run time to `seconds`."""

        def call(*args: Any, **options: Any) -> Any:
            began = time.perf_counter()
            try:
                return method(*args, **options)
            finally:
                self.seconds += time.perf_counter() - began

        return call


def megabytes(mapper: HazardMapper) -> float:
    """Return the memory that a mapper keeps between LiDAR scans, MB."""
    if isinstance(mapper, GaussianDemMapper):
        return mapper.pool.nbytes / 1e6
    assert isinstance(mapper, QuadtreeMapper)
    return (mapper.map.nbytes + mapper.selector.nbytes) / 1e6


def strata_of(world: World, truth: Any) -> np.ndarray:
    """Return the terrain class (index into `STRATA`) of each truth cell (rows, cols).

    The classes depend on true slope and rocks. The slope is that of the relief without rocks over
    the width of the lander.
    """
    grid, lander = truth.grid, truth.lander
    bare = Terrain(world.terrain.relief, RockField.empty()).raster(grid).astype(np.float64)
    reach = lander.leg_radius + 0.5 * lander.pad_diameter
    smooth = ndimage.uniform_filter(bare, round(2.0 * reach / grid.posting))
    north, east = np.gradient(smooth, grid.posting)
    slope = np.hypot(north, east) / np.tan(lander.slope_limit)
    tall = (world.terrain.raster(grid) - bare) > lander.roughness_limit
    near = ndimage.distance_transform_edt(~tall) * grid.posting < reach
    return np.where(slope >= 1.0, 3, np.where(near, 2, np.where(slope >= 0.5, 1, 0)))


def evaluate_map(
    hazard_map: HazardMap, selected: np.ndarray, safe: np.ndarray, strata: np.ndarray
) -> MapEvaluation:
    """Evaluate selected cells of a hazard map by their true safety and terrain class.

    `selected` (rows, cols) marks the cells; `safe` and `strata` are their true safety and class.
    """
    p = np.where(hazard_map.observed, hazard_map.p_safe, 0.0)[selected].astype(np.float64)
    s, k = safe[selected], strata[selected]
    called = p > 0.5
    counts = np.stack(
        [np.bincount(k[c], minlength=len(STRATA))
         for c in (called & s, called & ~s, ~called & s, ~called & ~s)], axis=-1,
    )  # fmt: skip
    claim = hazard_map.observed if hazard_map.in_domain is None else hazard_map.in_domain
    c = (claim & hazard_map.observed)[selected]
    claimed = np.stack(
        [np.bincount(k[c], weights=w[c], minlength=len(STRATA))
         for w in (np.ones(p.size), s.astype(np.float64), (p - s) ** 2)], axis=-1,
    )  # fmt: skip
    return MapEvaluation(counts, claimed, reliability(p[c], s[c]))


def truth_on_map_grid(
    grid: Grid, navigation_error: np.ndarray, truth: Any, raster: np.ndarray
) -> np.ndarray:
    """Return the values of a truth raster at the cells of a map grid.

    Cells outside the raster have the value at its edge. `navigation_error` is map minus true
    position, m.
    """
    own = truth.grid
    xy = grid.centres() - navigation_error[:2]
    row, col = own.cell(xy)
    at = np.clip(row, 0, own.rows - 1), np.clip(col, 0, own.cols - 1)
    return raster[at]


Maps = dict[str, HazardMap]


def fly(world_name: str, flight: int, root_seed: int) -> dict[str, Any]:
    """Simulate the flights over one terrain, one with each map and policy of `WAYS`.

    `world_name` is a name in `WORLDS`; the number of the flight and the root seed determine the
    random numbers.

    "landings" has the metrics of each flight by name in `WAYS`. "maps" has, by mapper, the
    evaluations of its map at the "first" and the "last" decision (None without), the computing time
    in "seconds" and the memory at the end in "megabytes".
    """
    plain = scenario_of(world_name)
    world = build_world(plain, RandomStreams(flight_seed(root_seed, flight)))
    truth = None
    landings: dict[str, dict[str, Any]] = {}
    maps: dict[str, dict[str, Any]] = {}
    for n, (way, (mapper, policy)) in enumerate(WAYS.items()):
        seed = flight_seed(root_seed, flight)
        carried = tuple(MAPPERS) if n == 0 else (mapper,)
        simulation = Simulation(
            with_mappers(plain, carried), seed, policy, world=world, truth=truth
        )
        truth = simulation.truth
        if n == 0:
            maps = _fly_all_mappers(simulation, strata_of(world, truth))
        else:
            simulation.run()
        landings[way] = evaluate(simulation.flight(), truth)
    return {"landings": landings, "maps": maps}


def _fly_all_mappers(simulation: Simulation, strata: np.ndarray) -> dict[str, dict[str, Any]]:
    """Fly with all mappers; evaluate their maps at the first and the last decision.

    `strata` (rows, cols) is the terrain class of the truth cells.
    """
    mappers = simulation.computer.mappers
    clocks = {name: SingleMapperTimer(mapper) for name, mapper in mappers.items()}
    seen: list[tuple[Maps, np.ndarray]] = []
    while not simulation.done:
        if simulation.decision_due:
            drawn = {name: mapper.hazard_map() for name, mapper in mappers.items()}
            if any(m.observed.any() for m in drawn.values()):
                seen = [*seen[:1], (drawn, simulation.navigation_error)]
        simulation.step()
    ends = [evaluate_maps(*moment, simulation.truth, strata) for moment in seen[:1] + seen[-1:]]
    return {
        name: {
            "first": asdict(ends[0][name]) if ends else None,
            "last": asdict(ends[-1][name]) if ends else None,
            "seconds": clocks[name].seconds, "megabytes": megabytes(mappers[name]),
        }
        for name in mappers
    }  # fmt: skip


def evaluate_maps(
    maps: Maps, navigation_error: np.ndarray, truth: Any, strata: np.ndarray
) -> dict[str, MapEvaluation]:
    """Evaluate several maps over the terrain that at least one of them has observed.

    `navigation_error` is map minus true position, m; `strata` is the class of the truth cells.
    Unobserved cells count as not called safe. Each map is evaluated on its own grid, because
    mappers can center their grids on different points.
    """
    out = {}
    for name, drawn in maps.items():
        where = np.logical_or.reduce([observed_on_grid(drawn.grid, m) for m in maps.values()])
        xy = drawn.grid.centres() - navigation_error[:2]
        where &= truth.is_known_at(xy)
        safe = truth.is_safe_at(xy)
        out[name] = evaluate_map(
            drawn, where, safe, truth_on_map_grid(drawn.grid, navigation_error, truth, strata)
        )
    return out


def observed_on_grid(grid: Grid, hazard_map: HazardMap) -> np.ndarray:
    """Return whether a hazard map has observed each cell of a grid (rows, cols)."""
    own, xy = hazard_map.grid, grid.centres()
    row, col = own.cell(xy)
    at = np.clip(row, 0, own.rows - 1), np.clip(col, 0, own.cols - 1)
    return np.asarray(own.contains(xy) & hazard_map.observed[at])
