"""Fly the descents of the all-sensor study and evaluate their hazard maps.

Every flight runs all mappers at once, so their maps use the same returns and images of the same
terrain. All maps are evaluated on the same cells at the same times.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import logit

from lunarsim import (
    HazardMap,
    RandomStreams,
    Scenario,
    Simulation,
    build_world,
    exact_safety,
)
from lunarsim.api import HazardMapper, LidarScan
from lunarsim.evaluation.map_quality import true_elevation_in_map_frame
from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.evaluation.reliability import reliability
from lunarsim.onboard.hazards.hazard_map import TerrainSurface
from lunarsim.world import World

Array = NDArray[np.float64]

HERE = Path(__file__).parent
SIZE, POSTING = 60.0, 0.25
# Ratio of the half side of the quadtree landing zone to that of the lander footprint (its paper).
ZONE = 1.35
DROPPED = 0.5
DEAD_BELOW = 400.0
# Minimum diameter of a large rock, m.
LARGE = 0.7
# Log-odds bins of the joint site counts of two maps.
ODDS = np.linspace(-8.0, 8.0, 33)
# "alone" has the form of the fused map but only the Gaussian DEM as input: it separates the effect
# of the form from that of the camera.
MAPS = {
    "dem": "Gaussian DEM", "quadtree": "quadtree", "rocks": "shadows", "alone": "fused, DEM only",
    "fused": "fused",
}  # fmt: skip
SINGLE = ("dem", "quadtree", "rocks")

_TILTED = {
    "kind": "dtm", "posting_m": 0.5, "detail": False, "mirrored_size_m": 500.0,
    "path": str(HERE / "data" / "hirise_dteec_010228_1490_crop.tif"),
}  # fmt: skip
_MIXED = {"shape": "mixed", "cover": 0.04, "burial": [0.0, 0.5]}
WORLDS: dict[str, dict[str, Any]] = {
    "level": {},
    "HiRISE 0.2": {"terrain": _TILTED | {"relief_scale": 0.2}},
    "HiRISE 0.5": {"terrain": _TILTED | {"relief_scale": 0.5}},
    "highland": {
        "terrain": {"preset": "highland", "rms_slope_deg": 4.0, "detail_m": 0.0},
        "rocks": _MIXED, "expected_rocks": _MIXED,
    },
    "15 % cover": {"rocks": {"cover": 0.15}, "expected_rocks": {"cover": 0.15}},
    "Sun 5 deg": {"sun": {"elevation_deg": 5.0}},
}  # fmt: skip


@dataclass(frozen=True)
class FusionStudyRow:
    """One condition (row) of the all-sensor study: terrain and sensor failures.

    Attributes
    ----------
    world
        Name of the simulated terrain in `WORLDS`; rows with the same name share it.
    lidar_dropouts
        Whether half of the LiDAR returns are lost.
    failed_sensors
        Sensors that stop measuring below `DEAD_BELOW`.
    remaining_map
        Name in `MAPS` of the map of the sensor that remains after a failure; empty without one.
    """

    world: str
    lidar_dropouts: bool = False
    failed_sensors: tuple[str, ...] = ()
    remaining_map: str = ""


ROWS: dict[str, FusionStudyRow] = {
    "level, rocks": FusionStudyRow("level"),
    "HiRISE, c = 0.2": FusionStudyRow("HiRISE 0.2"),
    "HiRISE, c = 0.5": FusionStudyRow("HiRISE 0.5"),
    "cratered highland": FusionStudyRow("highland"),
    "15 % cover": FusionStudyRow("15 % cover"),
    "Sun at 5 deg": FusionStudyRow("Sun 5 deg"),
    "LiDAR with 50 % drop-outs": FusionStudyRow("level", lidar_dropouts=True),
    "cameras dead from 400 m on": FusionStudyRow(
        "level", failed_sensors=("narrow", "wide"), remaining_map="dem"
    ),
    "LiDAR dead from 400 m on": FusionStudyRow(
        "level", failed_sensors=("flash",), remaining_map="rocks"
    ),
}


def scenario_of(world: str, altitudes: tuple[float, ...]) -> Scenario:
    """Return the descent over a terrain of `WORLDS` with all mappers.

    A LiDAR scan is taken above each of the `altitudes` of map evaluation (m).
    """
    base = Scenario.load(HERE / "all_sensors.toml").changed(**WORLDS[world])
    lander = base.vehicle.make()
    half = lander.leg_radius + 0.5 * lander.pad_diameter
    # On the trajectory of the scenario, with the speed scaled as in a fall from the start.
    highest = max(altitudes)
    top = max(1.2 * highest, highest + 40.0)
    start = base.start.make()
    share = top / start.position[2]
    rocks = base.expected_rocks
    # Height ratio of rocks: gives the minimum diameter that exceeds the roughness limit.
    ratio = {"hemisphere": 0.5, "cube": 1.0}.get(rocks.shape, rocks.height_ratio[0])
    return base.changed(
        start={
            "position_m": [share * x for x in start.position], "position_sigma_m": 0.0,
            "velocity_m_s": [np.sqrt(share) * v for v in start.velocity],
        },
        tasking={"flash": {"altitudes_m": [a + 15.0 for a in altitudes]}},
        mappers={
            "dem": {"size_m": SIZE, "posting_m": POSTING},
            "rocks": {
                "size_m": SIZE, "posting_m": POSTING,
                "min_hazard_diameter_m": lander.roughness_limit / ratio,
            },
            "quadtree": {
                "kind": "quadtree", "sensor": "flash", "size_m": SIZE, "posting_m": POSTING,
                "sites": {"zone_half_side_m": ZONE * half,
                "roughness_limit_m": lander.roughness_limit},
            },
            # Evaluated as it is at the altitude, not as it was for the last decision.
            "fused": {"interval_s": 0.0},
            "alone": {"kind": "fused", "inputs": ["dem"], "interval_s": 0.0},
        },
    )  # fmt: skip


def world_of(world: str, seed: SeedSequence) -> World:
    """Build the simulated terrain and light for a seed; `world` is a name in `WORLDS`."""
    return build_world(scenario_of(world, (100.0,)), RandomStreams(seed))


def fly(row: FusionStudyRow, altitudes: tuple[float, ...], seed: SeedSequence) -> dict[str, Any]:
    """Simulate one flight; return the site counts by map and altitude.

    `altitudes` are those of map evaluation, m.
    """
    scenario = scenario_of(row.world, altitudes)
    simulation = Simulation(scenario, seed, "no-divert", world=world_of(row.world, seed))
    mappers = simulation.computer.mappers
    if row.lidar_dropouts:
        for name in ("dem", "quadtree"):
            mappers[name].update = with_dropouts(mappers[name].update)  # type: ignore[method-assign]
    clock = MapperTimer({name: mappers[name] for name in MAPS})
    evaluated: dict[str, Any] = {}
    waiting = sorted(altitudes, reverse=True)
    while waiting and not simulation.done:
        simulation.step()
        if simulation.altitude < DEAD_BELOW:
            schedules = zip(scenario.tasking, simulation.computer.tasking, strict=True)
            for part in (part for name, part in schedules if name in row.failed_sensors):
                part.stop()
        if simulation.altitude <= waiting[0]:
            evaluated[f"{waiting.pop(0):g}"] = count_all_sites(simulation)
    refused = mappers["rocks"].rejected_images  # type: ignore[attr-defined]
    return {
        "maps": evaluated, "ms": clock.mean_ms(),
        "refused": {fault.name: count for fault, count in refused.items()},
    }  # fmt: skip


class MapperTimer:
    """Measure the computing time of each mapper, without the mappers that it calls.

    The methods of `mappers` (by name) are replaced by timed ones.
    """

    def __init__(self, mappers: dict[str, HazardMapper]) -> None:
        self._seconds = dict.fromkeys(mappers, 0.0)
        self._drawn: dict[str, dict[int, Any]] = {name: {} for name in mappers}
        self._inside = 0.0
        for name, mapper in mappers.items():
            for method in ("update", "refresh", "hazard_map", "evidence"):
                setattr(mapper, method, self._timed(name, getattr(mapper, method)))
            evaluated = partial(_evaluated_surface, mapper, mapper.terrain_surface)
            setattr(mapper, "terrain_surface", self._timed(name, evaluated))  # noqa: B010

    def _timed(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """Return a method of mapper `name` that adds its run time to the mapper's account."""

        def call(*args: Any) -> Any:
            began, others, self._inside = time.perf_counter(), self._inside, 0.0
            try:
                given = method(*args)
                if isinstance(given, HazardMap):
                    # Hold a reference, so that no other array receives the same id.
                    self._drawn[name][id(given.p_safe)] = given.p_safe
                return given
            finally:
                elapsed = time.perf_counter() - began
                self._seconds[name] += elapsed - self._inside
                self._inside = others + elapsed

        return call

    def mean_ms(self) -> dict[str, float]:
        """Return the computing time of each mapper per hazard map, ms."""
        return {n: 1e3 * s / max(len(self._drawn[n]), 1) for n, s in self._seconds.items()}


def _evaluated_surface(
    mapper: HazardMapper, surface: Callable[[], TerrainSurface]
) -> TerrainSurface:
    """Compute the hazard map of a mapper, then return its terrain surface.

    A timer then assigns the time of the map to its own mapper. `surface` is the mapper's method.
    """
    mapper.hazard_map()
    return surface()


def with_dropouts(update: Callable[..., None]) -> Callable[..., None]:
    """Wrap the `update` method of a LiDAR mapper so that half of the returns are lost."""

    def taken(scan: LidarScan, estimate: Any) -> None:
        # Seeded with the scan time: all mappers lose the same returns.
        lost = np.random.default_rng(round(1e3 * scan.time)).random(scan.range.shape) < DROPPED
        update(replace(scan, range=np.where(lost, np.nan, scan.range)), estimate)

    return taken


# --- map evaluation ---------------------------------------------------------------------------


@dataclass(frozen=True)
class MapTruth:
    """True safety of the terrain under a hazard map.

    Attributes
    ----------
    xy, safe
        Positions (n, 2), local frame, m, and whether they are safe (n,).
    under_large
        Whether a rock of diameter `LARGE` or more lies under the lander there (n,).
    objects
        Centers of rocks higher than the roughness limit (k, 2), local frame, m.
    """

    xy: Array
    safe: NDArray[np.bool_]
    under_large: NDArray[np.bool_]
    objects: Array


def map_truth(simulation: Simulation) -> MapTruth:
    """Return the true safety at the cell centers of the Gaussian DEM's current map."""
    lander, terrain = simulation.lander, simulation.world.terrain
    grid = simulation.computer.mappers["dem"].hazard_map().grid
    error = simulation.navigation_error
    truth = exact_safety(true_elevation_in_map_frame(terrain, grid, error), grid, lander)
    xy = grid.centres()[truth.observed]
    rocks = terrain.rocks
    middles = np.column_stack((rocks.x, rocks.y)) + error[:2]
    diameter = 2.0 * np.sqrt(rocks.a * rocks.b)
    footprint = lander.leg_radius + 0.5 * lander.pad_diameter
    near = grid.contains(middles)
    high = near & (rock_heights(terrain) >= lander.roughness_limit)
    return MapTruth(
        xy, truth.safe[truth.observed],
        has_rock_in_footprint(
            xy, middles[diameter >= LARGE], 0.5 * diameter[diameter >= LARGE], footprint
        ),
        middles[high],
    )  # fmt: skip


def rock_heights(terrain: Any) -> Array:
    """Return the height of each rock above the surrounding terrain (n,), m."""
    rocks = terrain.rocks
    middles = np.column_stack((rocks.x, rocks.y))
    around = 0.25 * np.pi * np.arange(8)
    ring = np.column_stack((np.cos(around), np.sin(around)))
    off = 1.3 * np.maximum(rocks.a, rocks.b)[:, None, None] * ring
    about = terrain.elevation((middles[:, None] + off).reshape(-1, 2)).reshape(-1, 8)
    return np.asarray(terrain.elevation(middles) - np.nanmedian(about, axis=1))


def has_rock_in_footprint(
    xy: Array, centers: Array, radius: Array, footprint: float
) -> NDArray[np.bool_]:
    """Return whether a rock reaches into the lander's footprint at positions (n,).

    `xy` (n, 2) are the positions, `centers` (k, 2) and `radius` (k,) describe the rocks, and
    `footprint` is the radius of the footprint, m.
    """
    out = np.zeros(len(xy), np.bool_)
    if len(centers):
        found = cKDTree(xy).query_ball_point(centers, radius + footprint)
        out[np.concatenate([np.asarray(own, np.int64) for own in found])] = True
    return out


def count_all_sites(simulation: Simulation) -> dict[str, Any]:
    """Count the sites of all current maps by predicted and true safety, for JSON."""
    truth = map_truth(simulation)
    drawn = {name: simulation.computer.mappers[name].hazard_map() for name in MAPS}
    found = {name: count_sites(one, truth) for name, one in drawn.items()}
    found["fused"]["joint"] = count_jointly(drawn["fused"], drawn["quadtree"], truth)
    return found


def count_jointly(fused: HazardMap, second: HazardMap, truth: MapTruth) -> list[Any]:
    """Count sites by true safety and by the p_safe of two maps, in bins.

    The result has the axes truth (unsafe, safe), bin of the fused map, bin of the second map; the
    bins are `ODDS`. The last bin of the second map counts sites that this map has not observed.
    Sites that the fused map has not observed are omitted.
    """
    kept = _layer_at(fused, fused.observed, truth.xy)
    xy, safe = truth.xy[kept], truth.safe[kept]
    place = [np.searchsorted(ODDS[1:-1], _log_odds(m.p_safe_at(xy))) for m in (fused, second)]
    columns = len(ODDS) - 1
    place[1] = np.where(_layer_at(second, second.observed, xy), place[1], columns)
    counts = np.zeros((2, columns, columns + 1), np.int64)
    np.add.at(counts, (safe.astype(np.int64), *place), 1)
    return list(counts.tolist())


def _log_odds(p: Array) -> Array:
    """Return log(p / (1 - p)) of probabilities; infinite at 0 and 1."""
    with np.errstate(divide="ignore"):
        return np.asarray(logit(p.astype(np.float64)))


def count_sites(hazard_map: HazardMap, truth: MapTruth) -> dict[str, Any]:
    """Count the sites of one hazard map by p_safe and true safety, for JSON.

    By p_safe: "unsafe" and "safe" sites, and "large", the sites over a large rock. "objects":
    number of high rocks, and of those with p_safe over 0.5. For observed sites (in the domain, if
    the map has one): "table" is the calibration table, "squares" the number of sites, of safe
    sites, and the sum of squared errors for the Brier score. "observed" is the observed fraction.
    """
    p = hazard_map.p_safe_at(truth.xy)
    layer = hazard_map.observed if hazard_map.in_domain is None else hazard_map.in_domain
    claimed = _layer_at(hazard_map, layer, truth.xy)
    curve = PrecisionRecall.of(p, truth.safe)
    large = PrecisionRecall.of(p, truth.under_large)
    c, s = p[claimed], truth.safe[claimed].astype(np.float64)
    over = hazard_map.p_safe_at(truth.objects) if len(truth.objects) else np.empty(0)
    return {
        "unsafe": curve.unsafe.tolist(),
        "safe": curve.safe.tolist(),
        "large": large.safe.tolist(),
        "objects": [len(over), int((over > 0.5).sum())],
        "table": reliability(c, s).tolist(),
        "squares": [float(c.size), float(s.sum()), float(((c - s) ** 2).sum())],
        "observed": float(_layer_at(hazard_map, hazard_map.observed, truth.xy).mean()),
    }


def _layer_at(hazard_map: HazardMap, layer: NDArray[np.bool_], xy: Array) -> NDArray[np.bool_]:
    """Return a boolean map layer at positions (n, 2), m; False outside the map."""
    g = hazard_map.grid
    row, col = g.cell(xy)
    found = layer[np.clip(row, 0, g.rows - 1), np.clip(col, 0, g.cols - 1)]
    return np.asarray(found & g.contains(xy))
