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
from typing import Any

import click
import numpy as np
from navigation_errors import SCENARIOS, error_of
from undeclared_failures import declared_table

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.api import LidarScan
from lunarsim.studies import Case, Report, Study, run_script

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


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight with a fault of the prior map or the scanner.

    The row has the maximum errors at the end in standard deviations (position, velocity, attitude),
    whether one of them exceeded five (`far`), the time at which navigation found its position on
    the map (s; NaN: never), whether navigation declared itself lost at the end and at any time, the
    number of `covariance-inflated` events, and whether the landing was safe.
    """
    row = ROWS[case["fault"]]
    # Every fault has its own terrain.
    flight = case.number * len(ROWS) + list(ROWS).index(case["fault"])
    scenario = Scenario.load(SCENARIOS / "morpheus.toml")
    if GROUNDS[case["terrain"]]:
        scenario = scenario.changed(terrain=GROUNDS[case["terrain"]])
    scenario = scenario.changed(prior_map=row.map_changes, sensors={"flash": row.scanner_changes})
    simulation = Simulation(scenario, flight_seed(case.seed, flight), "safest")
    navigation = simulation.computer.navigation
    take_unchanged, rng = navigation.take, np.random.default_rng([case.seed, flight])

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
    return {
        "error_sigmas": worst, "far": max(worst) > MAX_ERROR_SIGMA,
        "lock_s": locks[0] if locks else np.nan, "lost": lost, "ever_lost": "lost" in names,
        "inflated": names.count("covariance-inflated"),
        "safe": outcome is not None and outcome.safe,
    }  # fmt: skip


def print_declared(report: Report) -> None:
    """Print the number of large errors and of declared failures by fault.

    With `--cells`, the errors of every flight are printed first.
    """
    for f in report.rows if report.options["cells"] else ():
        off = ", ".join(f"{w:.1f}" for w in f["error_sigmas"])
        report.print(
            f"{f['fault']}, {f['terrain']}: {off} sigma, lock {f['lock_s']:.1f} s, "
            f"lost {f['lost']} (ever {f['ever_lost']}), suspect {f['inflated']}, safe {f['safe']}"
        )
    groups = [(fault, rows) for (fault,), rows in report.groups("fault").items()]
    title = "Flights on a prior map; hazard field and craters pooled"
    report.print(declared_table(title, "fault", [*groups, ("all", report.rows)]))


study = Study(
    fly,
    repeats="flights",
    count=2,
    factors={"fault": list(ROWS), "terrain": list(GROUNDS)},
    factor_help={"fault": "Name of a fault.", "terrain": "Name of a terrain."},
    options=(
        click.Option(
            ["--cells"], is_flag=True, default=False, help="Print the results of every flight also."
        ),
    ),
    report=print_declared,
)

if __name__ == "__main__":
    run_script(study)
