"""Whether navigation on a prior map says so when it is wrong: maps out of date, scanners that err.

Flies `morpheus.toml`, a LiDAR sweep on a prior map, over its hazard field and over cratered relief:
with maps of which up to 0.3 is out of date, that have voids or errors that are alike, with errors
of the scanner that nobody told of, and with flashes that fail after 6 s. An error is too large
where position, velocity or attitude is off by more than five of its standard deviations on an axis;
a flight fails undeclared if it ends so and navigation does not say that it is lost. The policy is
not told: landings show what a fault does.

python scenarios/navigation/prior_map.py --flights 2 --jobs 2
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from consistency import SCENARIOS, error_of
from study import declared_table, json_option, seed_and_jobs, write_flights

from lunarsim.campaign.pool import gathered
from lunarsim.console import plain_console
from lunarsim.messages.measurements import LidarScan
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

BEGINS, ENDS = 6.0, 10.0  # s
FAR = 5.0  # standard deviations
GROUNDS: dict[str, dict[str, Any]] = {
    "hazard field": {},
    "craters": {
        "kind": "fractal", "size_m": 320.0, "posting_m": 0.25, "rms_slope_deg": 2.0,
        "crater_min_diameter_m": 1.0,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Row:
    """What is wrong.

    Attributes
    ----------
    prior, scanner
        Keys of `[prior_map]` and of `[sensors.flash]`.
    kept
        Of a flash, its time (s) and a generator: whether it comes.
    """

    prior: dict[str, Any]
    scanner: dict[str, Any]
    kept: Callable[[float, np.random.Generator], bool] | None = None


ROWS: dict[str, Row] = {
    "none": Row({}, {}),
    "none, map of 1 m posts, 0.3 m": Row({"posting_m": 1.0, "sigma_m": 0.3}, {}),
    "0.1 of the map out of date": Row({"stale_share": 0.1}, {}),
    "0.2 of the map out of date": Row({"stale_share": 0.2}, {}),
    "0.3 of the map out of date": Row({"stale_share": 0.3}, {}),
    "0.05 of the map void": Row({"void_share": 0.05}, {}),
    "the map's errors alike over 5 m": Row({"correlation_m": 5.0}, {}),
    "ranges 0.3 m long": Row({}, {"range_bias_m": 0.3}),
    "boresight 0.5 deg off": Row({}, {"boresight_off_deg": 0.5}),
    "flashes 20 ms late": Row({}, {"late_s": 0.02}),
    "half of the flashes lost": Row({}, {}, lambda time, rng: rng.random() < 0.5),
    "no flashes for 4 s": Row({}, {}, lambda time, rng: not BEGINS <= time < ENDS),
    "no more flashes": Row({}, {}, lambda time, rng: time < BEGINS),
}


@dataclass(frozen=True)
class Task:
    """One flight with one thing wrong."""

    row: str
    ground: str
    flight: int
    seed: int


@dataclass(frozen=True)
class Flown:
    """What came of it.

    Attributes
    ----------
    row, ground
        What was wrong, and over which ground.
    worst
        Greatest errors at the end in standard deviations: position, velocity, attitude.
    lock
        When the place was found, s; NaN: never.
    lost, ever
        Whether navigation said so, at the end and at all.
    doubted
        How often it doubted a measurement.
    safe
        Whether the lander came down safely.
    """

    row: str
    ground: str
    worst: tuple[float, float, float]
    lock: float
    lost: bool
    ever: bool
    doubted: int
    safe: bool

    @property
    def far(self) -> bool:
        """Whether it was too far off at the end."""
        return max(self.worst) > FAR


def fly(task: Task) -> Flown:
    """Fly once."""
    row = ROWS[task.row]
    scenario = Scenario.load(SCENARIOS / "morpheus.toml")
    if GROUNDS[task.ground]:
        scenario = scenario.changed(terrain=GROUNDS[task.ground])
    scenario = scenario.changed(prior_map=row.prior, sensors={"flash": row.scanner})
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), "safest")
    navigation = simulation.computer.navigation
    honest, rng = navigation.take, np.random.default_rng([task.seed, task.flight])

    def tampered(sensor: str, measurement: Any, time: float) -> None:
        if isinstance(measurement, LidarScan) and row.kept and not row.kept(time, rng):
            return
        honest(sensor, measurement, time)

    navigation.take = tampered  # type: ignore[method-assign]
    while not simulation.done:
        # As long as the lander flies: nothing is measured at rest.
        sigma = np.sqrt(np.diag(simulation.estimate.covariance))
        off = np.abs(error_of(simulation)) / sigma
        lost = simulation.computer.estimate.lost
        simulation.step()
    names = [name for _, name, _ in simulation.computer.telemetry]
    locks = [time for time, name, _ in simulation.computer.telemetry if name == "lock"]
    worst = (float(off[:3].max()), float(off[3:6].max()), float(off[6:].max()))
    verdict = simulation.verdict
    return Flown(
        task.row, task.ground, worst, locks[0] if locks else np.nan, lost, "lost" in names,
        names.count("doubted"), verdict is not None and verdict.safe,
    )  # fmt: skip


@click.command()
@click.option(
    "--flights", type=click.IntRange(min=1), default=2, show_default=True,
    help="Over each ground with each thing wrong.",
)  # fmt: skip
@click.option(
    "--only", type=click.Choice(list(ROWS)), multiple=True,
    help="What is wrong; may be given again. Left out: every one.",
)  # fmt: skip
@json_option
@click.option("--cells", is_flag=True, help="Print every flight as well.")
@seed_and_jobs
def main(
    flights: int, only: tuple[str, ...], out: Path | None, cells: bool, seed: int, jobs: int
) -> None:
    """Fly on maps and scanners that are wrong, and see whether navigation says so."""
    console = plain_console(120)
    rows = list(only or ROWS)
    # No two rows fly over the same ground.
    tasks = [
        Task(row, ground, n * len(ROWS) + list(ROWS).index(row), seed)
        for row in rows for ground in GROUNDS for n in range(flights)
    ]  # fmt: skip
    flown = gathered(fly, tasks, jobs, console, "flights")
    for f in flown if cells else ():
        off = ", ".join(f"{w:.1f}" for w in f.worst)
        console.print(
            f"{f.row}, {f.ground}: {off} sigma, lock {f.lock:.1f} s, lost {f.lost} (ever {f.ever}),"
            f" doubted {f.doubted}, safe {f.safe}"
        )
    table = [(row, [f for f in flown if f.row == row]) for row in rows]
    title = "Flights on a prior map; hazard field and craters together"
    console.print(declared_table(title, "wrong", [*table, ("all", flown)]))
    write_flights(out, table)


if __name__ == "__main__":
    main()
