"""Measure the position errors of tracked rocks in the all-sensor study.

Rock positions are relative to the lander: errors that the lander and the rocks share cancel. The
table gives, for each terrain and altitude: the offset of tracked rocks from the nearest true ones,
averaged over the rocks of a flight (root mean square over flights); the standard deviation that
the filter reports for that mean; and the normalised squared error (2 if the filter is consistent).

python scenarios/rock_position_errors.py --fields 4 --jobs 2
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from sensor_fusion_flights import WORLDS, scenario_of, world_of

from lunarsim import Simulation, flight_seed
from lunarsim.studies import Case, Metric, Report, Study, metric_table, run_script

ALTITUDES_M = (1000.0, 700.0, 500.0, 200.0, 100.0)
# Minimum existence probability of a rock; minimum number of rocks; minimum radius of a true rock, m
# (smaller ones throw no tracked shadow); pairing distance: this or three times the median, m.
_MIN_EXISTENCE, _MIN_ROCKS, _MIN_RADIUS_M, _PAIRING_DISTANCE_M = 0.9, 5, 0.15, 0.7


def fly(case: Case) -> list[dict[str, Any]]:
    """Simulate one flight; return the rock position errors at each altitude."""
    seed = flight_seed(case.seed, case.number)
    world = world_of(case["terrain"], seed)
    scenario = scenario_of(case["terrain"], ALTITUDES_M)
    simulation = Simulation(scenario, seed, "no-divert", world=world)
    rows = []
    for altitude in ALTITUDES_M:
        while simulation.altitude > altitude and not simulation.done:
            simulation.step()
        rows.append({"altitude_m": altitude, **position_errors(simulation)})
    return rows


def position_errors(simulation: Simulation) -> dict[str, float]:
    """Compare the mean position of tracked rocks with the nearest true rocks.

    Returns the number of rocks and, for five rocks or more, error and reported sigma of the mean
    position relative to the lander (per axis, m) and normalised squared error (NEES).
    """
    tracker = simulation.computer.mappers["rocks"].tracker  # type: ignore[attr-defined]
    confirmed = np.flatnonzero(tracker.existence > _MIN_EXISTENCE)
    rocks = simulation.world.terrain.rocks
    true = np.column_stack((rocks.x, rocks.y)) + simulation.navigation_error[:2]
    true = true[np.sqrt(rocks.a * rocks.b) > _MIN_RADIUS_M]
    if len(confirmed) < _MIN_ROCKS:
        return dict.fromkeys(("rocks", "error_m", "sigma_m", "nees"), np.nan)
    distance, nearest = cKDTree(true).query(tracker.filter.xy[confirmed])
    paired = distance < max(_PAIRING_DISTANCE_M, 3.0 * float(np.median(distance)))
    error = (tracker.filter.xy[confirmed] - true[nearest])[paired].mean(axis=0)
    covariance = _mean_covariance(tracker.filter, confirmed[paired])
    return {
        "rocks": float(paired.sum()),
        "error_m": float(np.sqrt(0.5 * error @ error)),
        "sigma_m": float(np.sqrt(0.5 * np.trace(covariance))),
        "nees": float(error @ np.linalg.solve(covariance, error)),
    }


def _mean_covariance(rocks: Any, index: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the covariance (2, 2) of the rocks' mean position relative to the lander.

    It is in m^2. `rocks` is the filter of the rock tracker; `index` selects the rocks.
    """
    weights = np.zeros((2, rocks.state.size))
    for axis in range(2):
        weights[axis, rocks.state_indices(index)[:, axis]] = 1.0 / len(index)
        weights[axis, axis] = -1.0
    return np.asarray(weights @ rocks.covariance @ weights.T)


def print_errors(report: Report) -> None:
    """Print the position errors by terrain and altitude, over flights with enough rocks."""
    flights = [row for row in report.rows if np.isfinite(row["nees"])]
    title = f"Mean position of tracked rocks relative to the lander, seed {report.seed}"
    by_altitude = replace(report, rows=flights, factors=("terrain", "altitude_m"))
    report.print(metric_table(by_altitude, title))


study = Study(
    fly,
    repeats="fields",
    count=4,
    factors={"terrain": list(WORLDS)},
    factor_help={"terrain": "Terrain of the all-sensor study."},
    metrics={
        "rocks": Metric("rocks", "mean", 0),
        "error_m": Metric("error, RMS (m)", "rms"),
        "sigma_m": Metric("reported sigma, median (m)", "median"),
        "nees": Metric("NEES (2 dof)", "mean", 1),
    },
    report=print_errors,
)

if __name__ == "__main__":
    run_script(study)
