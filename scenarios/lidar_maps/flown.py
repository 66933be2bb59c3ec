"""Flights of one world on the map of each mapper, and what each map said when it was first asked.

Flights that share an index have the same world, start and noise; until the first decision they are
one flight, so that the maps of that moment are made of the same returns and can be set side by
side.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from lunarsim.evaluation.outcome import evaluate
from lunarsim.evaluation.reliability import EDGES, reliability
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapper
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper
from lunarsim.rng import Streams, flight_seed
from lunarsim.rocks.field import RockField
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation, build_world
from lunarsim.world import World
from lunarsim.world.terrain import Terrain
from lunarsim.world.truth import Truth

SCENARIOS = Path(__file__).resolve().parents[1]
# File and what is changed in it.
WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    "hazard field": ("morpheus.toml", {}),
    "HiRISE, c = 0.2": ("hirise.toml", {}),
    "HiRISE, c = 0.5": ("hirise.toml", {"terrain": {"relief_scale": 0.5}}),
    "cratered highland": ("highland.toml", {}),
    "Apollo 15": ("apollo15.toml", {}),
}
# Mapper and policy.
WAYS: dict[str, tuple[str, str]] = {
    "Gaussian DEM, calibrated": ("calibrated", "safest"),
    "Gaussian DEM, Eqs. 15-17": ("level", "safest"),
    "quadtree": ("quadtree", "safest"),
    "quadtree, scoreboard": ("quadtree", "scoreboard"),
}
# Half side of the quadtree's landing zone over that of the lander's footprint, as in the paper.
ZONE = 1.35
STRATA = (
    "level, no rock",
    "sloping, no rock",
    "rock in the footprint",
    "steeper than the limit",
)


@dataclass(frozen=True)
class Task:
    """One index of one world."""

    world: str
    flight: int
    seed: int


@dataclass(frozen=True)
class Judged:
    """A map against the truth, by stratum.

    Attributes
    ----------
    counts
        Hits, false safe, missed, rejected (strata, 4).
    squares
        Sums over cells of the squared error of the probability (strata,).
    table
        Of `reliability`, for all ground together (bins, 3).
    observed
        Cells that the map has seen.
    """

    counts: np.ndarray
    squares: np.ndarray
    table: np.ndarray
    observed: int


@dataclass(frozen=True)
class Flown:
    """One flight on one map: its row of results, its map at the first decision, what it took.

    Attributes
    ----------
    row
        As `lunarsim.evaluation.outcome.evaluate` gives it.
    judged
        None without a decision.
    seconds
        That the mapper worked during the flight.
    megabytes
        That it kept at the end.
    """

    row: dict[str, Any]
    judged: Judged | None
    seconds: float
    megabytes: float


def scenario_of(world: str) -> Scenario:
    """Return the scenario of a world."""
    file, changes = WORLDS[world]
    return Scenario.load(SCENARIOS / file).changed(**changes)


def with_mapper(scenario: Scenario, mapper: str) -> Scenario:
    """Return a scenario whose one mapper is of another kind, over the same ground."""
    (name, own), *_ = scenario.mappers.items()
    ground = {"sensor": own.sensor, "size_m": own.size_m, "posting_m": own.posting_m}
    if mapper != "quadtree":
        table = ground | {"kind": "gaussian-dem", "safety": mapper}
    elif own.kind == "quadtree":
        return scenario
    else:
        lander = scenario.vehicle.make()
        sites = {
            "zone_m": ZONE * (lander.leg_radius + 0.5 * lander.pad_diameter),
            "roughness_limit_m": lander.roughness_limit,
        }
        table = ground | {"kind": "quadtree", "sites": sites}
    return scenario.changed(mappers={name: None}).changed(mappers={name: table})


class Clock:
    """Counts the time that a mapper works."""

    def __init__(self, mapper: HazardMapper) -> None:
        self.seconds = 0.0
        for name in ("update", "refresh", "hazard_map", "scoreboard", "correct"):
            setattr(mapper, name, self._timed(getattr(mapper, name)))

    def _timed(self, method: Any) -> Any:
        def call(*args: Any, **options: Any) -> Any:
            began = time.perf_counter()
            try:
                return method(*args, **options)
            finally:
                self.seconds += time.perf_counter() - began

        return call


def megabytes(mapper: HazardMapper) -> float:
    """Return what a mapper keeps between scans, MB."""
    if isinstance(mapper, GaussianDemMapper):
        return mapper.pool.nbytes / 1e6
    assert isinstance(mapper, QuadtreeMapper)
    return (mapper.map.nbytes + mapper.selector.nbytes) / 1e6


def strata_of(world: World, truth: Truth) -> np.ndarray:
    """Return the stratum of each cell of the truth (rows, cols), by the true ground.

    The slope is that of the relief without rocks over the lander's width.
    """
    grid, lander = truth.safety.grid, truth.lander
    bare = Terrain(world.terrain.relief, RockField.empty()).raster(grid).astype(np.float64)
    reach = lander.leg_radius + 0.5 * lander.pad_diameter
    smooth = ndimage.uniform_filter(bare, round(2.0 * reach / grid.posting))
    north, east = np.gradient(smooth, grid.posting)
    slope = np.hypot(north, east) / np.tan(lander.slope_limit)
    tall = (truth.elevation - bare) > lander.roughness_limit
    near = ndimage.distance_transform_edt(~tall) * grid.posting < reach
    return np.where(slope >= 1.0, 3, np.where(near, 2, np.where(slope >= 0.5, 1, 0)))


def judge(hazard_map: HazardMap, where: np.ndarray, safe: np.ndarray, strata: np.ndarray) -> Judged:
    """Judge cells (rows, cols) of a map by whether they are safe and their strata (rows, cols)."""
    p = np.where(hazard_map.observed, hazard_map.p_safe, 0.0)[where].astype(np.float64)
    s, k = safe[where], strata[where]
    called = p > 0.5
    counts = np.stack(
        [np.bincount(k[c], minlength=len(STRATA))
         for c in (called & s, called & ~s, ~called & s, ~called & ~s)], axis=-1,
    )  # fmt: skip
    squares = np.bincount(k, weights=(p - s) ** 2, minlength=len(STRATA))
    seen = hazard_map.observed[where]
    table = reliability(p[seen], s[seen], EDGES)
    return Judged(counts, squares, table, int(hazard_map.observed.sum()))


def first_map(simulation: Simulation) -> Iterator[tuple[HazardMap, np.ndarray]]:
    """Fly to the end; yield the map of the first decision and the error of its place (3,), m."""
    asked = False
    while not simulation.done:
        if simulation.decision_due and not asked:
            asked = True
            yield simulation.observe().hazard_map, simulation.navigation_error
        simulation.step()


def under(grid: Grid, error: np.ndarray, truth: Truth, raster: np.ndarray) -> np.ndarray:
    """Return what a raster of the truth has under the cells of a map; off it the last stratum."""
    own = truth.safety.grid
    xy = grid.centres() - error[:2]
    row, col = own.cell(xy)
    at = np.clip(row, 0, own.rows - 1), np.clip(col, 0, own.cols - 1)
    return raster[at]


def fly(task: Task) -> dict[str, Flown]:
    """Fly one index of one world on each map."""
    seed = flight_seed(task.seed, task.flight)
    plain = scenario_of(task.world)
    world = build_world(plain, Streams(seed))
    truth = Truth.of(world, plain.vehicle.make())
    strata = strata_of(world, truth)
    flown: dict[str, Any] = {}
    maps: dict[str, tuple[HazardMap, np.ndarray]] = {}
    for way, (mapper, policy) in WAYS.items():
        scenario = with_mapper(plain, mapper)
        simulation = Simulation(scenario, flight_seed(task.seed, task.flight), policy,
                                world=world, truth=truth)  # fmt: skip
        (own,) = simulation.computer.mappers.values()
        clock = Clock(own)
        for first in first_map(simulation):
            maps[way] = first
        row = evaluate(simulation.flight(), truth)
        flown[way] = (row, clock.seconds, megabytes(own))
    # Ground that any of the maps has seen: what a map has not seen it does not call safe.
    seen = np.logical_or.reduce([m.observed for m, _ in maps.values()]) if maps else None
    return {
        way: Flown(
            row, _judged(*maps[way], seen, truth, strata) if way in maps else None, seconds, size
        )
        for way, (row, seconds, size) in flown.items()
    }


def _judged(
    hazard_map: HazardMap, error: np.ndarray, seen: Any, truth: Truth, strata: np.ndarray
) -> Judged:
    grid = hazard_map.grid
    inside = truth.safety.grid.contains(grid.centres() - error[:2])
    safe = under(grid, error, truth, truth.safety.safe)
    known = under(grid, error, truth, truth.safety.observed)
    return judge(hazard_map, seen & inside & known, safe, under(grid, error, truth, strata))
