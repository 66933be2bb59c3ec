"""Test whether navigation declares itself lost with map or scanner faults.

The script flies `morpheus.toml`, a LiDAR sweep on a prior map, over its hazard field and over
cratered relief. The faults are: a map of which up to 0.3 is outdated, voids or correlated errors in
the map, unmodelled scanner errors, and flashes (LiDAR scans) that fail after 6 s. An error is too
large if position, velocity or attitude exceeds five standard deviations on an axis. A flight fails
undeclared if it ends with such an error and navigation does not declare itself lost. The policy is
not informed: landing results show the effect of a fault.

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
from shared_options import declared_table, json_option, seed_and_jobs, write_flights

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.api import LidarScan
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console

FAULT_START_S, FAULT_END_S = 6.0, 10.0  # s
MAX_ERROR_SIGMA = 5.0  # standard deviations
GROUNDS: dict[str, dict[str, Any]] = {
    "hazard field": {},
    "craters": {
        "kind": "fractal", "size_m": 320.0, "posting_m": 0.25, "rms_slope_deg": 2.0,
        "crater_min_diameter_m": 1.0,
    },
}  # fmt: skip


@dataclass(frozen=True)
class PriorMapFault:
    """A fault of the prior map or of the LiDAR scanner.

    Attributes
    ----------
    map_changes, scanner_changes
        Changed keys of `[prior_map]` and of `[sensors.flash]`.
    is_delivered
        Function of scan time (s) and random generator that returns whether the scan is delivered;
        None: all scans are.
    """

    map_changes: dict[str, Any]
    scanner_changes: dict[str, Any]
    is_delivered: Callable[[float, np.random.Generator], bool] | None = None


ROWS: dict[str, PriorMapFault] = {
    "none": PriorMapFault({}, {}),
    "none, map of 1 m posts, 0.3 m": PriorMapFault({"posting_m": 1.0, "sigma_m": 0.3}, {}),
    "0.1 of the map out of date": PriorMapFault({"outdated_fraction": 0.1}, {}),
    "0.2 of the map out of date": PriorMapFault({"outdated_fraction": 0.2}, {}),
    "0.3 of the map out of date": PriorMapFault({"outdated_fraction": 0.3}, {}),
    "0.05 of the map void": PriorMapFault({"void_fraction": 0.05}, {}),
    "the map's errors alike over 5 m": PriorMapFault({"correlation_m": 5.0}, {}),
    "ranges 0.3 m long": PriorMapFault({}, {"range_bias_m": 0.3}),
    "boresight 0.5 deg off": PriorMapFault({}, {"boresight_bias_deg": 0.5}),
    "flashes 20 ms late": PriorMapFault({}, {"latency_bias_s": 0.02}),
    "half of the flashes lost": PriorMapFault({}, {}, lambda time, rng: rng.random() < 0.5),
    "no flashes for 4 s": PriorMapFault(
        {}, {}, lambda time, rng: not FAULT_START_S <= time < FAULT_END_S
    ),
    "no more flashes": PriorMapFault({}, {}, lambda time, rng: time < FAULT_START_S),
}


@dataclass(frozen=True)
class PriorMapTask:
    """Settings of one simulated flight with a fault of the prior map or the scanner.

    `fault` is a name in `ROWS`, `terrain` a name in `GROUNDS`; `flight` and `seed` (root seed)
    determine the terrain and the noise.
    """

    fault: str
    terrain: str
    flight: int
    seed: int


@dataclass(frozen=True)
class PriorMapFlight:
    """Results of one simulated flight with a fault of the prior map or the scanner.

    Attributes
    ----------
    fault, terrain
        Name of the fault and of the terrain.
    error_sigmas
        Maximum errors at the end in standard deviations: position, velocity, attitude.
    lock
        Time at which navigation found its position on the map, s; NaN: never.
    lost, ever_lost
        Whether navigation declared itself lost at the end, and whether it ever did.
    inflated
        Number of `covariance-inflated` events (suspect measurements).
    safe
        Whether the landing was safe.
    """

    fault: str
    terrain: str
    error_sigmas: tuple[float, float, float]
    lock: float
    lost: bool
    ever_lost: bool
    inflated: int
    safe: bool

    @property
    def far(self) -> bool:
        """Whether an error exceeded five standard deviations at the end."""
        return max(self.error_sigmas) > MAX_ERROR_SIGMA


def fly(task: PriorMapTask) -> PriorMapFlight:
    """Simulate one flight with a fault of the prior map or the scanner."""
    row = ROWS[task.fault]
    scenario = Scenario.load(SCENARIOS / "morpheus.toml")
    if GROUNDS[task.terrain]:
        scenario = scenario.changed(terrain=GROUNDS[task.terrain])
    scenario = scenario.changed(prior_map=row.map_changes, sensors={"flash": row.scanner_changes})
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), "safest")
    navigation = simulation.computer.navigation
    take_unchanged, rng = navigation.take, np.random.default_rng([task.seed, task.flight])

    def take_faulty(sensor: str, measurement: Any, time: float) -> None:
        if (
            isinstance(measurement, LidarScan)
            and row.is_delivered
            and not row.is_delivered(time, rng)
        ):
            return
        take_unchanged(sensor, measurement, time)

    navigation.take = take_faulty  # type: ignore[method-assign]
    while not simulation.done:
        # Only in flight: no measurements are taken at rest.
        sigma = np.sqrt(np.diag(simulation.estimate.covariance))
        off = np.abs(error_of(simulation)) / sigma
        lost = simulation.computer.estimate.lost
        simulation.step()
    names = [name for _, name, _ in simulation.computer.telemetry]
    locks = [time for time, name, _ in simulation.computer.telemetry if name == "lock"]
    worst = (float(off[:3].max()), float(off[3:6].max()), float(off[6:].max()))
    outcome = simulation.outcome
    return PriorMapFlight(
        task.fault, task.terrain, worst, locks[0] if locks else np.nan, lost, "lost" in names,
        names.count("covariance-inflated"), outcome is not None and outcome.safe,
    )  # fmt: skip


@click.command()
@click.option(
    "--flights", type=click.IntRange(min=1), default=2, show_default=True,
    help="Number of flights for each combination of terrain and fault.",
)  # fmt: skip
@click.option(
    "--only", type=click.Choice(list(ROWS)), multiple=True,
    help="Name of a fault to simulate; repeat the option for several faults (default: all).",
)  # fmt: skip
@json_option
@click.option("--cells", is_flag=True, help="Print the results of every flight also.")
@seed_and_jobs
def main(
    flights: int, only: tuple[str, ...], out: Path | None, cells: bool, seed: int, jobs: int
) -> None:
    """Fly with faults of prior map and scanner; count large errors not declared.

    Large errors exceed five standard deviations at the end of a flight.
    """
    console = plain_console(120)
    rows = list(only or ROWS)
    # Every fault has its own terrain.
    tasks = [
        PriorMapTask(row, terrain, n * len(ROWS) + list(ROWS).index(row), seed)
        for row in rows for terrain in GROUNDS for n in range(flights)
    ]  # fmt: skip
    flown = collect_results(fly, tasks, jobs, console, "flights")
    for f in flown if cells else ():
        off = ", ".join(f"{w:.1f}" for w in f.error_sigmas)
        console.print(
            f"{f.fault}, {f.terrain}: {off} sigma, lock {f.lock:.1f} s, lost {f.lost} (ever "
            f"{f.ever_lost}), suspect {f.inflated}, safe {f.safe}"
        )
    table = [(row, [f for f in flown if f.fault == row]) for row in rows]
    title = "Flights on a prior map; hazard field and craters pooled"
    console.print(declared_table(title, "fault", [*table, ("all", flown)]))
    write_flights(out, table)


if __name__ == "__main__":
    main()
