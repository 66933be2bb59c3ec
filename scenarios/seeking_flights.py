"""Flights of the study of information-seeking descents: what is flown, and how maps are judged.

Three paths from the shadow EKF paper's set-up: the direct one, the one bent by hand so that it
overflies the site (a faster start, and an acceleration asked for at the end), and the one that the
law `information-seeking` chooses from the start of the direct one. A hazard is a rock of 0.5 m or
more, the ground has slopes of its own.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from lunarsim.evaluation.classification import classify
from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.onboard.policies.reach import Reach
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

HERE = Path(__file__).parent
PATHS = ("nominal", "modified", "seeking")
SENSORS = ("camera", "lidar", "both")
ALTITUDES = (300.0, 250.0, 200.0, 150.0, 100.0, 75.0, 50.0)
HAZARD = 0.5  # least diameter, m
# A site counts as known to be safe from this probability on.
SURE = 0.99
SIZE, POSTING = 60.0, 0.25
# Azimuth and elevation of the Sun, slope (RMS at 1 m), cover.
LOW, HIGH = (0.0, 5.0, 0.0, 0.02), (360.0, 40.0, 4.0, 0.15)


@dataclass(frozen=True)
class Ground:
    """Sun and ground of a flight: azimuth, elevation and slope in deg, cover as a share."""

    azimuth: float = 225.0
    elevation: float = 20.0
    slope: float = 0.0
    cover: float = 0.05


@dataclass(frozen=True)
class Task:
    """One flight."""

    path: str
    field: int
    seed: int
    sensors: str = "camera"
    ground: Ground = Ground()

    @property
    def key(self) -> str:
        """Name of the flight in the file."""
        return f"{self.sensors} / {self.field} / {self.path}"


def sobol(count: int, seed: int) -> list[Ground]:
    """Return grounds by Sobol's sequence over Sun, slope and cover, scrambled by a seed."""
    drawn = qmc.Sobol(4, scramble=True, seed=seed).random_base2(int(np.ceil(np.log2(count))))
    points = qmc.scale(drawn[:count], LOW, HIGH)
    return [Ground(*(round(float(v), 4) for v in row)) for row in points]


def scenario_of(task: Task) -> Scenario:
    """Return the descent of a task: a map of 60 m about the site, two pictures a second.

    Sites are chosen from 75 m down to 50 m.
    """
    g = task.ground
    start = "modified" if task.path == "modified" else "nominal"
    changes: dict[str, Any] = {
        "terrain": {"posting_m": 1.0, "rms_slope_deg": g.slope},
        "rocks": {"cover": g.cover},
        "expected_rocks": {"cover": g.cover},
        "sun": {"azimuth_deg": g.azimuth, "elevation_deg": g.elevation},
        "decisions": {"first_altitude_m": 75.0, "last_altitude_m": 50.0},
    }
    if task.path == "seeking":
        changes["guidance"] = {"kind": "information-seeking"}
    return Scenario.load(HERE / f"shadow_{start}.toml").changed(**changes, **_eyes(task.sensors))


def _eyes(sensors: str) -> dict[str, Any]:
    """Return the tables of camera, LiDAR or both."""
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
        # Without rocks to navigate by, an inertial unit alone drifts by metres from scan to scan.
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
            **flash["mappers"], "rocks": map_of, "fused": {"kind": "fused", "of": ["dem", "rocks"]},
        },
    }  # fmt: skip


def fly(task: Task) -> dict[str, Any]:
    """Fly once; return what the map said on the way down and how it ended, as JSON has it."""
    scenario = scenario_of(task)
    simulation = Simulation(scenario, flight_seed(task.seed, task.field), policy="safest")
    pending, levels = list(ALTITUDES), {}
    while not simulation.done:
        simulation.step()
        if pending and simulation.altitude <= pending[0]:
            last = len(pending) == 1
            levels[f"{pending.pop(0):g}"] = judged(simulation, whole=last)
            if last:
                simulation.computer.stop_sensors()
    verdict = simulation.verdict
    touched = verdict is not None and verdict.touchdown is not None
    told = simulation.computer.telemetry
    return {
        "ground": asdict(task.ground),
        "levels": levels,
        "propellant": simulation.lander.wet_mass - simulation.state.mass,
        "duration": simulation.time,
        "landed": touched,
        "safe": bool(touched and verdict is not None and verdict.safe),
        "fallbacks": sum(name == "guidance-fallback" for _, name, _ in told),
        "plans": sum(name == "guidance-planned" for _, name, _ in told),
    }


def judged(simulation: Simulation, *, whole: bool) -> dict[str, Any]:
    """Compare the map that decides with the truth, in the frame that the lander lands in.

    Sites are looked at a metre apart. With `whole` also how the cells of a shadow map are classed.
    """
    computer = simulation.computer
    hazard_map = computer.mapper.hazard_map()
    every = max(1, round(1.0 / hazard_map.grid.posting))
    part = (slice(every // 2, None, every),) * 2
    site = hazard_map.grid.centres()[part].reshape(-1, 2)
    p = np.where(hazard_map.observed, hazard_map.p_safe, 0.0)[part].ravel()
    safe = free_of_hazards(simulation, site - simulation.navigation_error[:2])
    known = (p >= SURE) & safe
    reach = Reach.under(hazard_map, computer.site, computer.cost_of)
    area = (every * hazard_map.grid.posting) ** 2
    out: dict[str, Any] = {
        "known_m2": float(known.sum() * area),
        "known_in_reach_m2": float((known & reach.at(site)).sum() * area),
        "safe_m2": float(safe.sum() * area),
        "in_reach_m2": float(reach.at(site).sum() * area),
        "unsafe_called_safe": int(((p >= SURE) & ~safe).sum()),
        "unsafe": int((~safe).sum()),
        "place": [float(v) for v in simulation.state.position - computer.briefing.target],
    }
    out["recall_at_099"] = PrecisionRecall.of(p, safe).recall_at(0.99)
    if whole and "rocks" in computer.mappers:
        out |= cells_of(simulation)
    return out


def free_of_hazards(simulation: Simulation, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell at which true places (n, 2) no hazard's outline reaches under the lander (n,)."""
    rocks = simulation.world.terrain.rocks
    lander = simulation.lander
    large = 2.0 * rocks.a >= HAZARD
    centre = np.column_stack((rocks.x, rocks.y))[large]
    near = rocks.reach()[large] + lander.leg_radius + 0.5 * lander.pad_diameter
    out = np.ones(len(xy), bool)
    for c, r in zip(centre, near, strict=True):
        out &= np.hypot(xy[:, 0] - c[0], xy[:, 1] - c[1]) >= r
    return out


def cells_of(simulation: Simulation) -> dict[str, Any]:
    """Return how a shadow map classes its cells, and how many hazards it calls clear altogether."""
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
