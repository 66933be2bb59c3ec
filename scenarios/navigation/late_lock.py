"""Compare landings with an early, a late and no lock on the prior map.

A lock is the first accepted position of the lander on the map. The script flies `morpheus.toml`
over the same fields, with the map available to navigation from the start, later, or never, and with
the initial error of the scenario or a larger one. Terrain is mapped in the local frame from the
first scan, and the policy decides on that map with or without a lock. Paired flights differ only in
the lock.

python scenarios/navigation/late_lock.py --flights 10 --map-time 0 --map-time 12 --map-time 24
--map-time inf python scenarios/navigation/late_lock.py --flights 10 --position-sigma 0.01
--position-sigma 100 --map-time inf
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from rich.table import Table
from scipy.stats import binomtest
from shared_options import seed_and_jobs

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion
from lunarsim.onboard.navigation.navigator import Navigator

SCENARIOS = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class LateLockTask:
    """Settings of one simulated flight with a prior map that becomes available late.

    Attributes
    ----------
    map_time
        Time at which navigation receives the map, s; infinite: never.
    position_sigma
        Initial position error, 1 sigma per axis, m; None: that of the scenario.
    scenario
        Path of the scenario file.
    flight, seed
        Number of the flight and root seed.
    policy
        Name of the retargeting policy.
    """

    map_time: float
    position_sigma: float | None
    scenario: str
    flight: int
    seed: int
    policy: str


@dataclass(frozen=True)
class LateLockFlight:
    """Results of one simulated flight with a prior map that becomes available late.

    Attributes
    ----------
    lock
        Time at which navigation found its position on the map, s; NaN: never.
    site_displacement
        Displacement of the landing site in the onboard frame at the lock, m.
    max_jump
        Maximum change of the position estimate in one cycle minus the distance flown, m.
    decisions
        Number of retargeting decisions with a map.
    miss
        Distance between touchdown and the selected site, m.
    error_sigmas
        Maximum position error on an axis in the last cycle, in standard deviations.
    lost
        Whether navigation declared itself lost at the end.
    safe
        Whether the landing was safe.
    """

    lock: float
    site_displacement: float
    max_jump: float
    decisions: int
    miss: float
    error_sigmas: float
    lost: bool
    safe: bool


def fly(task: LateLockTask) -> LateLockFlight:
    """Simulate one flight in which navigation receives the prior map at a given time."""
    scenario = Scenario.load(Path(task.scenario))
    if task.position_sigma is not None:
        scenario = scenario.changed(initial_uncertainty={"position_m": task.position_sigma})
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), task.policy)
    computer = simulation.computer
    navigation = computer.navigation
    if not isinstance(navigation, Navigator) or navigation.matcher is None:
        raise click.UsageError(
            f"{task.scenario}: must contain the table [prior_map] for navigation"
        )
    matcher = navigation.processors.pop(navigation.processors.index(navigation.matcher))
    jumped, decisions, sigmas = 0.0, 0, np.nan
    while not simulation.done:
        if matcher not in navigation.processors and simulation.time >= task.map_time:
            navigation.processors.insert(0, matcher)
        before = simulation.estimate
        if simulation.decision_due and computer.mapper is not None:
            decisions += not computer.mapper.is_empty
        simulation.step()
        after = simulation.estimate
        if not simulation.done:
            way = 0.5 * (before.velocity + after.velocity) * (after.time - before.time)
            jumped = max(jumped, float(np.linalg.norm(after.position - before.position - way)))
            sigmas = max_error_sigma(simulation)
    locks = [e for e in navigation.events if e.name == "lock"]
    touchdown = simulation.outcome.touchdown
    aimed = simulation.site - simulation.navigation_error
    return LateLockFlight(
        locks[0].time if locks else np.nan,
        locks[0].details["moved"] if locks else np.nan,
        jumped,
        decisions,
        np.nan if touchdown is None else float(np.hypot(*(touchdown.position - aimed)[:2])),
        sigmas,
        simulation.estimate.lost,
        simulation.outcome.safe,
    )


def max_error_sigma(simulation: Simulation) -> float:
    """Return the maximum position error over the axes, in standard deviations."""
    error = np.abs(simulation.site_error)
    return float((error / np.sqrt(np.diag(simulation.estimate.covariance)[:3])).max())


def table_of(flights_by_variant: dict[str, list[LateLockFlight]]) -> Table:
    """Return the table of landing results by time of map availability.

    A variant is a time with an initial error. The others are compared with the first.
    """
    table = Table(title="Landings by the time at which the map becomes available")
    for heading in ("map available from, initial error", "flights with\na lock",
    "lock time,\nmedian (s)",
                    "site displacement\nat the lock (m)", "estimate jump,\nmaximum (m)",
                    "decisions,\nmedian", "touchdown miss,\nmedian, max (m)",
                    "over 5 sigma,\nnot declared lost", "safe landings",
                    "against the first:\nbetter, worse (p)"):  # fmt: skip
        table.add_column(heading, justify="right")
    first = [f.safe for f in next(iter(flights_by_variant.values()))]
    for n, (name, mine) in enumerate(flights_by_variant.items()):
        found = [f for f in mine if np.isfinite(f.lock)]
        safe = [f.safe for f in mine]
        low, high = Proportion(sum(safe), len(safe)).interval
        won = sum(a and not b for a, b in zip(safe, first, strict=True))
        lost = sum(b and not a for a, b in zip(safe, first, strict=True))
        p = binomtest(won, won + lost).pvalue if won + lost else 1.0
        missed = [f.miss for f in mine]
        table.add_row(
            name, f"{len(found)}",
            f"{np.median([f.lock for f in found]):.1f}" if found else "",
            f"{np.median([f.site_displacement for f in found]):.1f}" if found else "",
            f"{max(f.max_jump for f in mine):.2f}",
            f"{np.median([f.decisions for f in mine]):.0f}",
            f"{np.nanmedian(missed):.2f}, {np.nanmax(missed):.2f}",
            f"{sum(f.error_sigmas > 5.0 and not f.lost for f in mine)}",
            f"{sum(safe)} of {len(safe)} [{low:.2f}, {high:.2f}]",
            "" if n == 0 else f"{won}, {lost} ({p:.2f})",
        )  # fmt: skip
    return table


@click.command()
@click.option("--scenario", type=click.Path(exists=True, dir_okay=False),
              default=str(SCENARIOS / "morpheus.toml"), show_default="morpheus.toml",
              help="Scenario to fly (TOML file); it must have a prior map.")  # fmt: skip
@click.option("--flights", type=click.IntRange(min=1), default=5, show_default=True,
              help="Number of flights for each variant; all variants fly over the same "
              "terrain.")  # fmt: skip
@click.option("--map-time", "map_times", type=click.FloatRange(min=0.0), multiple=True,
              default=(0.0, 12.0, float("inf")), show_default=True,
              help="Time in the flight from which the prior map is available (s); inf: never. "
              "Repeat the option for several times.")  # fmt: skip
@click.option("--position-sigma", "position_sigmas", type=click.FloatRange(min=1e-3), multiple=True,
              help="Initial position error, 1 sigma per axis (m); repeat the option for several "
              "values (default: value of the scenario).")  # fmt: skip
@click.option(
    "--policy",
    default="safest",
    show_default=True,
    help="Policy that selects the landing site: a name from `lunarsim parts policy`.",
)
@seed_and_jobs
def main(
    scenario: str, flights: int, map_times: tuple[float, ...], position_sigmas: tuple[float, ...],
    policy: str, seed: int, jobs: int,
) -> None:  # fmt: skip
    """Compare landings for which the prior map is available early, late or never."""
    console = plain_console(150)
    flown: dict[str, list[LateLockFlight]] = {}
    for start in position_sigmas or (None,):
        for late in map_times:
            tasks = [LateLockTask(late, start, scenario, n, seed, policy) for n in range(flights)]
            name = f"{late:g} s" + ("" if start is None else f", {start:g} m")
            flown[name] = collect_results(fly, tasks, jobs, console, name)
    console.print(table_of(flown))


if __name__ == "__main__":
    main()
