"""Measure the position errors of tracked rocks in the all-sensor study.

Rock positions are relative to the lander: errors that the lander and the rocks share cancel. The
table gives, for each terrain and altitude: the offset of tracked rocks from the nearest true ones,
averaged over the rocks of a flight (root mean square over flights); the standard deviation that
the filter reports for that mean; and the normalised squared error (2 if the filter is consistent).

python scenarios/rock_position_errors.py --fields 4 --jobs 2
"""

from __future__ import annotations

from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.spatial import cKDTree
from sensor_fusion_flights import WORLDS, scenario_of, world_of

from lunarsim import Simulation, flight_seed
from lunarsim.campaign.pool import iterate_results
from lunarsim.console import plain_console, plain_progress

Array = NDArray[np.float64]

# Minimum existence probability of a rock; minimum number of rocks; minimum radius of a true rock, m
# (smaller ones throw no tracked shadow); pairing distance: this or three times the median, m.
_MIN_EXISTENCE, _MIN_ROCKS, _MIN_RADIUS_M, _PAIRING_DISTANCE_M = 0.9, 5, 0.15, 0.7


class RockPositionTask(NamedTuple):
    """Settings of one simulated flight of the rock position study.

    `world` is the name of the terrain, `field` its number, `seed` the root seed and `altitudes` the
    altitudes of evaluation (m).
    """

    world: str
    field: int
    seed: int
    altitudes: tuple[float, ...]


def fly(task: RockPositionTask) -> dict[float, Any]:
    """Simulate one flight; return the rock position errors at each altitude (m)."""
    seed = flight_seed(task.seed, task.field)
    scenario = scenario_of(task.world, task.altitudes)
    simulation = Simulation(scenario, seed, "no-divert", world=world_of(task.world, seed))
    found = {}
    for altitude in task.altitudes:
        while simulation.altitude > altitude and not simulation.done:
            simulation.step()
        found[altitude] = position_errors(simulation)
    return found


def position_errors(simulation: Simulation) -> tuple[float, float, float, int] | None:
    """Compare the mean position of tracked rocks with the nearest true rocks.

    Returns error and reported sigma of the mean position relative to the lander (per axis, m),
    normalised squared error (NEES), and number of rocks. None with fewer than five rocks.
    """
    tracker = simulation.computer.mappers["rocks"].tracker  # type: ignore[attr-defined]
    confirmed = np.flatnonzero(tracker.existence > _MIN_EXISTENCE)
    rocks = simulation.world.terrain.rocks
    true = np.column_stack((rocks.x, rocks.y)) + simulation.navigation_error[:2]
    true = true[np.sqrt(rocks.a * rocks.b) > _MIN_RADIUS_M]
    if len(confirmed) < _MIN_ROCKS:
        return None
    away, nearest = cKDTree(true).query(tracker.filter.xy[confirmed])
    paired = away < max(_PAIRING_DISTANCE_M, 3.0 * float(np.median(away)))
    error = (tracker.filter.xy[confirmed] - true[nearest])[paired].mean(axis=0)
    covariance = _mean_covariance(tracker.filter, confirmed[paired])
    nees = float(error @ np.linalg.solve(covariance, error))
    claim = float(np.sqrt(0.5 * np.trace(covariance)))
    return float(np.sqrt(0.5 * error @ error)), claim, nees, int(paired.sum())


def _mean_covariance(rocks: Any, index: NDArray[np.int64]) -> Array:
    """Return the covariance (2, 2) of the rocks' mean position relative to the lander.

    It is in m^2. `rocks` is the filter of the rock tracker; `index` selects the rocks.
    """
    weights = np.zeros((2, rocks.state.size))
    for axis in range(2):
        weights[axis, rocks.state_indices(index)[:, axis]] = 1.0 / len(index)
        weights[axis, axis] = -1.0
    return np.asarray(weights @ rocks.covariance @ weights.T)


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=4, show_default=True,
              help="Number of random rock fields for each terrain.")  # fmt: skip
@click.option(
    "--seed",
    type=int,
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
def main(fields: int, seed: int, jobs: int) -> None:
    """Fly and print the position errors of tracked rocks by terrain and altitude."""
    altitudes = (1000.0, 700.0, 500.0, 200.0, 100.0)
    tasks = [RockPositionTask(world, n, seed, altitudes) for world in WORLDS for n in range(fields)]
    flights: list[Any] = [None] * len(tasks)
    console = plain_console(110)
    with plain_progress(console) as progress:
        bar = progress.add_task("flights", total=len(tasks))
        for index, found in iterate_results(fly, tasks, jobs):
            flights[index] = found
            progress.advance(bar)
    table = Table(title=f"Mean position of tracked rocks relative to the lander, seed {seed}")
    for name in (
        "terrain",
        "altitude (m)",
        "flights",
        "rocks",
        "error, RMS (m)",
        "reported sigma (m)",
        "NEES (2 dof)",
    ):
        table.add_column(name)
    for world in WORLDS:
        own = [f for task, f in zip(tasks, flights, strict=True) if task.world == world]
        for altitude in altitudes:
            rows = np.array([f[altitude] for f in own if f[altitude] is not None])
            if not len(rows):
                table.add_row(world, f"{altitude:g}", "0", *4 * ["-"])
                continue
            off = np.sqrt((rows[:, 0] ** 2).mean())
            nees, count = rows[:, 2:].mean(axis=0)
            table.add_row(world, f"{altitude:g}", str(len(rows)), f"{count:.0f}", f"{off:.3f}",
                          f"{np.median(rows[:, 1]):.3f}", f"{nees:.1f}")  # fmt: skip
    console.print(table)


if __name__ == "__main__":
    main()
