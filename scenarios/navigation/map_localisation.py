"""Measure how fast and reliably a LiDAR sweep is located on prior maps.

No flight is simulated: a vehicle on a straight path sweeps the terrain around its target as in
`tasking.sweep`, with errors of position (30 m per axis), attitude (0.5 deg) and velocity
(0.05 m/s). Its scans are searched on the map until the position is certain. Every search has its
own terrain, map and errors; the measured terrain is one crop with random targets.

python scenarios/navigation/map_localisation.py --searches 20 --jobs 2
python scenarios/navigation/map_localisation.py --map "objects 0.5 m, 0.1 m, outdated 0.2"
--searches 300
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table

from lunarsim import Grid, RandomStreams, Scenario, Terrain, build_world, flight_seed
from lunarsim.api import State, gimbal_mount
from lunarsim.frames import attitude_from_thrust, quat_from_rotation_vector, quat_multiply
from lunarsim.onboard.navigation.map_features import MapFeatures, forecast_lock
from lunarsim.onboard.navigation.place_search import MapMatch, PlaceSearch
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.world import World
from lunarsim.world.survey import simulate_survey
from lunarsim.world.terrain import add_craters, fractal_relief, hazard_field

SCENARIOS = Path(__file__).resolve().parents[1]
UPRIGHT = attitude_from_thrust([0.0, 0.0, 1.0], np.pi / 2)
LIDAR = FlashLidar(128, 128, 0.0131, 5e-5)
START, VELOCITY = np.array([-390.0, 0.0, 240.0]), np.array([10.0, 0.0, -5.0])
SWEPT, RATE, SEARCH = 90.0, 20.0, 0.5
SIGMA, TURN, DRIFT = 30.0, np.deg2rad(0.5), 0.05
SIZE = 300.0


def make_hazard_field(rng: np.random.Generator) -> World:
    """Generate a hazard field: boulders and craters on horizontal terrain."""
    return World(hazard_field(rng), 9.81)


def make_craters(rng: np.random.Generator) -> World:
    """Generate fractal relief (RMS slope 2 deg) with craters wider than 1 m."""
    grid = Grid.centred((0.0, 0.0), 400.0, 0.5)
    relief = fractal_relief(grid, rng, hurst=0.9, rms_slope=np.deg2rad(2.0))
    return World(Terrain(add_craters(relief, rng, minimum=1.0)), 1.62)


@cache
def load_apollo15() -> World:
    """Build the measured terrain of Apollo 15 with simulated detail; cached."""
    scenario = Scenario.load(SCENARIOS / "apollo15.toml")
    return build_world(scenario, RandomStreams(flight_seed(1, 0)))


def make_apollo15(rng: np.random.Generator) -> World:
    """Return the measured relief of the Apollo 15 region; `rng` has no effect."""
    return load_apollo15()


@dataclass(frozen=True)
class MapCase:
    """Terrain and prior map of one map of the localisation study.

    `make_world` generates the terrain; `posting` is the grid spacing of the map and `sigma` its
    noise (m); `map_defects` holds further arguments of `simulate_survey`, such as voids.
    """

    make_world: Callable[[np.random.Generator], World]
    posting: float
    sigma: float
    map_defects: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        name = {make_hazard_field: "objects", make_craters: "craters", make_apollo15: "Apollo 15"}[
            self.make_world
        ]
        wrong = ", ".join(f"{k.split('_')[0]} {v:g}" for k, v in self.map_defects.items())
        return f"{name} {self.posting:g} m, {self.sigma:g} m" + (f", {wrong}" if wrong else "")


MAPS = (
    MapCase(make_hazard_field, 0.5, 0.1),
    MapCase(make_hazard_field, 0.5, 0.1, {"outdated_fraction": 0.2}),
    MapCase(make_hazard_field, 0.5, 0.1, {"outdated_fraction": 0.3}),
    MapCase(make_hazard_field, 0.5, 0.1, {"void_fraction": 0.05}),
    MapCase(make_hazard_field, 0.5, 0.1, {"correlation": 2.0}),
    MapCase(make_hazard_field, 0.5, 0.3),
    MapCase(make_hazard_field, 1.0, 0.3),
    MapCase(make_hazard_field, 3.0, 0.1),
    MapCase(make_craters, 0.5, 0.3),
    MapCase(make_craters, 1.0, 0.3),
    MapCase(make_craters, 1.0, 0.3, {"outdated_fraction": 0.2}),
    MapCase(make_craters, 1.0, 0.3, {"void_fraction": 0.05}),
    MapCase(make_craters, 1.0, 0.3, {"correlation": 3.0}),
    MapCase(make_craters, 3.0, 0.3),
    MapCase(make_apollo15, 1.0, 0.3),
    MapCase(make_apollo15, 5.0, 0.3),
    MapCase(make_apollo15, 5.0, 0.3, {"outdated_fraction": 0.2}),
)
MAPS_BY_NAME = {str(one): one for one in MAPS}


@dataclass
class SweepingLander:
    """Vehicle that scans terrain on a straight path, with state estimation errors.

    `target` (3,) is the center of the scanned square, m; the path leads to a point above the
    target.
    """

    world: World
    target: np.ndarray
    rng: np.random.Generator

    def __post_init__(self) -> None:
        self.shift = SIGMA * self.rng.standard_normal(3)
        self.drift = DRIFT * self.rng.standard_normal(3)
        turn = quat_from_rotation_vector(TURN * self.rng.standard_normal(3))
        self.attitude = quat_multiply(UPRIGHT, turn)
        # Height correction, m: when it is known, the sweep is aimed with it.
        self.up = 0.0

    def scan(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the estimated and the true points of a scan by its number (n, 3), m.

        They are computed with the estimated and with the true state of the vehicle.
        """
        time = number / RATE
        true = self.target + START + VELOCITY * time
        believed = true - self.shift + self.drift * time
        aim = self.target + sweep_aim_point(number) - believed - np.array([0.0, 0.0, self.up])
        mount = gimbal_mount(self.attitude, aim)
        state = State(true, VELOCITY, UPRIGHT, np.zeros(3), 1.0)
        scan = LIDAR.measure(self.world, state, time, self.rng, mount)
        return scan.points(believed, self.attitude), scan.points(true, UPRIGHT)


def sweep_aim_point(scan_number: int) -> np.ndarray:
    """Return the aim point of a scan relative to the center of the sweep (3,), m."""
    rows = 20
    row, col = divmod(scan_number, rows)
    row %= rows
    col = col if row % 2 == 0 else rows - 1 - col
    return SWEPT * (np.array([row, col, 0.0]) / (rows - 1) - np.array([0.5, 0.5, 0.0]))


def simulate_search(case: Case) -> dict[str, Any]:
    """Simulate a LiDAR sweep; search for the lander's position on the prior map.

    The row has the time (s) and the number of scans until the lock (first accepted position; time
    NaN: none), the position error at the lock and its standard deviation (east, north and up, m),
    whether a lock was predicted from the map before flight, and the horizontal position error at
    the start (m).
    """
    chosen = MAPS_BY_NAME[case["map"]]
    rng = np.random.default_rng([case.seed, MAPS.index(chosen), case.number])
    world = chosen.make_world(rng)
    xy = rng.uniform(-60.0, 60.0, 2) if chosen.make_world is make_apollo15 else np.zeros(2)
    target = np.append(xy, float(world.terrain.elevation(xy)))
    grid = Grid.centred(target, SIZE, chosen.posting)
    prior = simulate_survey(world.terrain, grid, rng, sigma=chosen.sigma, **chosen.map_defects)
    places = PlaceSearch(MapFeatures(prior))
    forecast = forecast_lock(prior, (float(xy[0]), float(xy[1])), SWEPT, SIGMA).can_lock
    lander = SweepingLander(world, target, rng)
    found: dict[str, Any] = {
        "time_s": np.nan, "error_m": [np.nan] * 3, "sigma_m": [np.nan] * 3,
        "lock_predicted": forecast, "start_error_m": float(np.hypot(*lander.shift[:2])),
    }  # fmt: skip
    for count in range(round(case["seconds"] * RATE)):
        found["scans"] = count + 1
        believed, true = lander.scan(count)
        places.add(believed)
        if (count + 1) % round(SEARCH * RATE):
            continue
        match = places.search(count / RATE, np.zeros(2), np.eye(2) * (SIGMA**2 + 16.0), DRIFT)
        if match is None:
            continue
        if match.vertical_shift_variance < 4.0:
            lander.up = match.vertical_shift
        if is_lock(match):
            error = match.shift - np.nanmean(true - believed, axis=0)
            sigma = np.sqrt(np.diag(match.covariance))
            return found | {"time_s": count / RATE, "error_m": error, "sigma_m": sigma}
    return found


def is_lock(match: MapMatch) -> bool:
    """Return whether navigation would accept a match of scan and map as its position."""
    return match.certainty >= 0.99999 and match.agreeing_fraction >= 0.6


def row_of(name: str, results: list[dict[str, Any]]) -> list[str]:
    """Format the search results of one map as a row of the table."""
    locked = [f for f in results if np.isfinite(f["time_s"])]
    away = [f["start_error_m"] for f in results if not np.isfinite(f["time_s"])]
    missed = f"{min(away):.0f} to {max(away):.0f}" if away else ""
    if not locked:
        return [name, f"0 of {len(results)}", "", "", "0", "", predicted_text(results), missed]
    time = [f["time_s"] for f in locked]
    error, sigma = (np.array([f[key] for f in locked])[:, :2] for key in ("error_m", "sigma_m"))
    lateral = np.abs(error).max(axis=1)
    wrong = int(np.sum(lateral > np.maximum(2.0 * MAPS_BY_NAME[name].posting, 2.0)))
    return [
        name, f"{len(locked)} of {len(results)}",
        f"{np.median(time):.1f} / {max(time):.1f}",
        f"{np.median([f['scans'] for f in locked]):.0f}", f"{wrong}",
        f"{np.median(lateral):.2f} m, {np.abs(error / sigma).max():.1f}",
        predicted_text(results), missed,
    ]  # fmt: skip


def predicted_text(results: list[dict[str, Any]]) -> str:
    """Format the number of searches for which a lock was predicted: "count of total"."""
    return f"{sum(f['lock_predicted'] for f in results)} of {len(results)}"


def print_searches(report: Report) -> None:
    """Print time, error and success of the searches by map."""
    table = Table(title=f"Searches with a time limit of {report.options['seconds']:g} s")
    for heading in ("map", "locked", "lock time, median / max (s)", "scans", "wrong",
                    "error, median; max error / sigma", "predicted",
                    "not locked: initial error (m)"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "map" else "right")
    for (name,), rows in report.groups("map").items():
        table.add_row(*row_of(name, rows))
    report.print(table)


study = Study(
    simulate_search,
    repeats="searches",
    count=10,
    factors={"map": list(MAPS_BY_NAME)},
    factor_help={"map": "Name of a map."},
    options=(
        click.Option(
            ["--seconds"], type=click.FloatRange(min=1.0), default=15.0, show_default=True,
            help="Time limit of a position search (s).",
        ),
    ),
    report=print_searches,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
