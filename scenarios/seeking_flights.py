"""Fly the descents of the information-seeking study and evaluate their maps.

Three paths in the set-up of the shadow EKF paper: the direct path; the path modified manually so
that it overflies the site (a faster start and a commanded terminal acceleration); and the path
that the guidance law `information-seeking` chooses from the start of the direct path. A hazard is
a rock with a diameter of 0.5 m or more. The terrain has slopes.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray
from scipy.stats import qmc

from lunarsim import Scenario, Simulation
from lunarsim.evaluation.classification import classify
from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.onboard.policies.reachability import ReachabilityMap

HERE = Path(__file__).parent
PATHS = ("nominal", "modified", "seeking")
SENSORS = ("camera", "lidar", "both")
ALTITUDES = (300.0, 250.0, 200.0, 150.0, 100.0, 75.0, 50.0)
HAZARD = 0.5  # minimum hazard diameter, m
# A site counts as known to be safe from this probability.
MIN_SAFE_PROBABILITY = 0.99
SIZE, POSTING = 60.0, 0.25
# Azimuth and elevation of the Sun, slope (RMS at 1 m), cover.
LOW, HIGH = (0.0, 5.0, 0.0, 0.02), (360.0, 40.0, 4.0, 0.15)


@dataclass(frozen=True)
class SunAndTerrain:
    """Sun and terrain of one flight.

    `azimuth` and `elevation` of the Sun and RMS `slope` at 1 m are in deg; `cover` is the rock
    cover (fraction).
    """

    azimuth: float = 225.0
    elevation: float = 20.0
    slope: float = 0.0
    cover: float = 0.05


def sample_conditions(count: int, seed: int) -> list[SunAndTerrain]:
    """Sample Sun azimuth and elevation, slope and cover by scrambled Sobol points.

    `count` is the number of points.
    """
    drawn = qmc.Sobol(4, scramble=True, seed=seed).random_base2(int(np.ceil(np.log2(count))))
    points = qmc.scale(drawn[:count], LOW, HIGH)
    return [SunAndTerrain(*(round(float(v), 4) for v in row)) for row in points]


def scenario_of(path: str, sensors: str, g: SunAndTerrain) -> Scenario:
    """Return the scenario of a flight: shadow EKF descent with a smaller map.

    `path` is a name in `PATHS` and `sensors` one in `SENSORS`. The map is 60 m wide; sites are
    selected between altitudes of 75 m and 50 m.
    """
    start = "modified" if path == "modified" else "nominal"
    changes: dict[str, Any] = {
        "terrain": {"posting_m": 1.0, "rms_slope_deg": g.slope},
        "rocks": {"cover": g.cover},
        "expected_rocks": {"cover": g.cover},
        "sun": {"azimuth_deg": g.azimuth, "elevation_deg": g.elevation},
        "decisions": {"first_altitude_m": 75.0, "last_altitude_m": 50.0},
    }
    if path == "seeking":
        changes["guidance"] = {"kind": "information-seeking"}
    return Scenario.load(HERE / f"shadow_{start}.toml").changed(
        **changes, **_sensor_tables(sensors)
    )


def _sensor_tables(sensors: str) -> dict[str, Any]:
    """Return the scenario tables of sensors and mappers for camera, LiDAR or both."""
    map_of = {"size_m": SIZE, "posting_m": POSTING}
    camera = {"rate_hz": 2.0}
    flash = {
        "sensors": {"flash": {"kind": "flash-lidar"}},
        "tasking": {"flash": {"kind": "at-altitudes", "altitudes_m": [300.0, 200.0, 130.0, 80.0]}},
        "mappers": {"dem": {"kind": "gaussian-dem", "sensor": "flash", **map_of}},
    }
    if sensors == "camera":
        return {"mappers": {"rocks": map_of}, "tasking": {"camera": camera}}
    if sensors == "lidar":
        # Without rocks as landmarks, inertial navigation drifts by metres between scans.
        fixes = {"fixes": {"kind": "navigation-fix"}, "altimeter": None}
        return {
            "sensors": {**flash["sensors"], **fixes, "camera": None},
            "tasking": {**flash["tasking"], "camera": None},
            "mappers": {**flash["mappers"], "rocks": None},
            "navigation": {"kind": "fixes"},
        }
    return {
        "sensors": flash["sensors"],
        "tasking": {**flash["tasking"], "camera": camera},
        "mappers": {
            **flash["mappers"], "rocks": map_of, "fused": {"kind": "fused", "inputs": ["dem",
            "rocks"]},
        },
    }  # fmt: skip


def fly(path: str, sensors: str, conditions: SunAndTerrain, seed: SeedSequence) -> dict[str, Any]:
    """Simulate one flight; return map metrics by altitude and the outcome."""
    simulation = Simulation(scenario_of(path, sensors, conditions), seed, policy="safest")
    pending, levels = list(ALTITUDES), {}
    while not simulation.done:
        simulation.step()
        if pending and simulation.altitude <= pending[0]:
            last = len(pending) == 1
            levels[f"{pending.pop(0):g}"] = map_metrics(simulation, with_cells=last)
            if last:
                simulation.computer.stop_sensors()
    outcome, events = simulation.outcome, [name for _, name, _ in simulation.computer.telemetry]
    return {
        "path": path, "ground": asdict(conditions), "levels": levels,
        "propellant": simulation.lander.wet_mass - simulation.state.mass,
        "duration": simulation.time, "landed": outcome.touchdown is not None,
        "safe": bool(outcome.touchdown is not None and outcome.safe),
        "fallbacks": events.count("guidance-fallback"), "plans": events.count("guidance-planned"),
    }  # fmt: skip


def map_metrics(simulation: Simulation, *, with_cells: bool) -> dict[str, Any]:
    """Compare the hazard map used for decisions with the truth, in the onboard frame.

    Sites are sampled at a spacing of 1 m. `with_cells` adds the classification of shadow map cells.
    Returns areas of known, reachable and safe sites (m^2) and other metrics by name.
    """
    computer = simulation.computer
    hazard_map = computer.mapper.hazard_map()
    every = max(1, round(1.0 / hazard_map.grid.posting))
    part = (slice(every // 2, None, every),) * 2
    site = hazard_map.grid.centres()[part].reshape(-1, 2)
    p = np.where(hazard_map.observed, hazard_map.p_safe, 0.0)[part].ravel()
    safe = free_of_hazards(simulation, site - simulation.navigation_error[:2])
    known = (p >= MIN_SAFE_PROBABILITY) & safe
    reach = ReachabilityMap.over_map(hazard_map, computer.site, computer.cost_of)
    area = (every * hazard_map.grid.posting) ** 2
    out: dict[str, Any] = {
        "known_m2": float(known.sum() * area),
        "known_in_reach_m2": float((known & reach.at(site)).sum() * area),
        "safe_m2": float(safe.sum() * area),
        "in_reach_m2": float(reach.at(site).sum() * area),
        "unsafe_called_safe": int(((p >= MIN_SAFE_PROBABILITY) & ~safe).sum()),
        "unsafe": int((~safe).sum()),
        "place": [float(v) for v in simulation.state.position - computer.briefing.target],
    }
    out["recall_at_099"] = PrecisionRecall.of(p, safe).recall_at(0.99)
    if with_cells and "rocks" in computer.mappers:
        out |= shadow_cell_metrics(simulation)
    return out


def free_of_hazards(simulation: Simulation, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether no hazard lies under the lander at true positions `xy` (n, 2), m."""
    rocks = simulation.world.terrain.rocks
    lander = simulation.lander
    large = 2.0 * rocks.a >= HAZARD
    centre = np.column_stack((rocks.x, rocks.y))[large]
    near = rocks.reach()[large] + lander.leg_radius + 0.5 * lander.pad_diameter
    out = np.ones(len(xy), bool)
    for c, r in zip(centre, near, strict=True):
        out &= np.hypot(xy[:, 0] - c[0], xy[:, 1] - c[1]) >= r
    return out


def shadow_cell_metrics(simulation: Simulation) -> dict[str, Any]:
    """Return clear-cell metrics of the shadow map, and counts of missed hazards."""
    mapper = simulation.computer.mappers["rocks"]
    p = mapper.probability.probability(mapper.tracker)
    seen = mapper.probability.observed
    rocks = simulation.world.terrain.rocks
    rock = simulation.world.terrain.rock_raster(mapper.grid.moved(-simulation.navigation_error))
    large = 2.0 * rocks.a >= HAZARD
    occupied = (rock >= 0) & large[np.maximum(rock, 0)]
    classes = classify(p, occupied, observed=seen)
    number = np.where(occupied, rock, -1).ravel() + 1
    cells = np.bincount(number, minlength=len(large) + 1)[1:]
    clear = ((p < 0.0025) & seen).ravel()
    wrong = np.bincount(number, weights=clear, minlength=len(large) + 1)[1:]
    return {
        "clear": classes.rates["clear_recall"],
        "clear_false": classes.rates["clear_false"],
        "hazards": int((cells > 0).sum()),
        "hazards_clear": int(((cells > 0) & (wrong == cells)).sum()),
    }
