"""Whether a late lock on the prior map lands as safe as an early one, and none at all.

Flies `morpheus.toml` over the same fields with the map handed to navigation from the start, later,
or never, and with an error at the start of the scenario's size or larger. Ground is mapped in the
local frame from the first scan on, and the policy decides on that map, whether or not there is a
lock. Pairs of flights differ in nothing but that.

python scenarios/navigation/late_lock.py --flights 10 --late 0 --late 12 --late 24 --late inf
python scenarios/navigation/late_lock.py --flights 10 --start 0.01 --start 100 --late inf
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from rich.table import Table
from scipy.stats import binomtest
from study import seed_and_jobs

from lunarsim.campaign.pool import gathered
from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

SCENARIOS = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Task:
    """One flight.

    Attributes
    ----------
    late
        Before this the map is kept from navigation, s.
    start
        Error of position at the start, 1 sigma an axis, m; None: the scenario's.
    """

    late: float
    start: float | None
    scenario: str
    flight: int
    seed: int
    policy: str


@dataclass(frozen=True)
class Flown:
    """What came of it.

    Attributes
    ----------
    lock
        When the place was found, s; NaN: never.
    moved
        How far the site moved in the local frame with the lock, m.
    jumped
        Farthest that the lander's estimate moved in the local frame in a cycle, besides what it
        flew, m.
    decisions
        How often the policy was asked while something had been mapped.
    missed
        Distance between where the lander came down and where it meant to, m.
    sigmas
        Greatest error of position or attitude on an axis in the last cycle, in its own deviations.
    lost
        Whether navigation called itself lost at the end.
    safe
        Whether the lander came down safely.
    """

    lock: float
    moved: float
    jumped: float
    decisions: int
    missed: float
    sigmas: float
    lost: bool
    safe: bool


def fly(task: Task) -> Flown:
    """Fly once."""
    scenario = Scenario.load(Path(task.scenario))
    if task.start is not None:
        scenario = scenario.changed(start_knowledge={"position_m": task.start})
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), task.policy)
    computer = simulation.computer
    navigation = computer.navigation
    if not isinstance(navigation, Navigator) or navigation.matcher is None:
        raise click.UsageError(f"{task.scenario}: its navigation knows no map")
    matcher = navigation.parts.pop(navigation.parts.index(navigation.matcher))
    jumped, decisions, sigmas = 0.0, 0, np.nan
    while not simulation.done:
        if matcher not in navigation.parts and simulation.time >= task.late:
            navigation.parts.insert(0, matcher)
        before = simulation.estimate
        if simulation.decision_due and computer.mapper is not None:
            decisions += not computer.mapper.blank
        simulation.step()
        after = simulation.estimate
        if not simulation.done:
            way = 0.5 * (before.velocity + after.velocity) * (after.time - before.time)
            jumped = max(jumped, float(np.linalg.norm(after.position - before.position - way)))
            sigmas = off_by(simulation)
    locks = [e for e in navigation.events if e.name == "lock"]
    touchdown = simulation.verdict.touchdown
    aimed = simulation.site - simulation.navigation_error
    return Flown(
        locks[0].time if locks else np.nan,
        locks[0].details["moved"] if locks else np.nan,
        jumped,
        decisions,
        np.nan if touchdown is None else float(np.hypot(*(touchdown.position - aimed)[:2])),
        sigmas,
        simulation.estimate.lost,
        simulation.verdict.safe,
    )


def off_by(simulation: Simulation) -> float:
    """Return the greatest error of position on an axis in its own deviations."""
    error = np.abs(simulation.site_error)
    return float((error / np.sqrt(np.diag(simulation.estimate.covariance)[:3])).max())


def summary(flown: dict[str, list[Flown]]) -> Table:
    """Return a line each way of flying."""
    table = Table(title="Landings by when the map was handed over")
    for heading in ("map from, start", "locked", "lock,\nmedian (s)",
                    "site moved by\nthe lock (m)", "lander jumped at\nmost, local (m)",
                    "decisions,\nmedian", "off its aim,\nmedian, most (m)",
                    "over 5 sigma,\nnot called lost", "landed safe",
                    "against the first:\nwon, lost (p)"):  # fmt: skip
        table.add_column(heading, justify="right")
    first = [f.safe for f in next(iter(flown.values()))]
    for n, (name, mine) in enumerate(flown.items()):
        found = [f for f in mine if np.isfinite(f.lock)]
        safe = [f.safe for f in mine]
        low, high = Proportion(sum(safe), len(safe)).interval
        won = sum(a and not b for a, b in zip(safe, first, strict=True))
        lost = sum(b and not a for a, b in zip(safe, first, strict=True))
        p = binomtest(won, won + lost).pvalue if won + lost else 1.0
        missed = [f.missed for f in mine]
        table.add_row(
            name, f"{len(found)}",
            f"{np.median([f.lock for f in found]):.1f}" if found else "",
            f"{np.median([f.moved for f in found]):.1f}" if found else "",
            f"{max(f.jumped for f in mine):.2f}",
            f"{np.median([f.decisions for f in mine]):.0f}",
            f"{np.nanmedian(missed):.2f}, {np.nanmax(missed):.2f}",
            f"{sum(f.sigmas > 5.0 and not f.lost for f in mine)}",
            f"{sum(safe)} of {len(safe)} [{low:.2f}, {high:.2f}]",
            "" if n == 0 else f"{won}, {lost} ({p:.2f})",
        )  # fmt: skip
    return table


@click.command()
@click.option("--scenario", type=click.Path(exists=True, dir_okay=False),
              default=str(SCENARIOS / "morpheus.toml"), show_default="morpheus.toml",
              help="Scenario with a prior map.")  # fmt: skip
@click.option("--flights", type=click.IntRange(min=1), default=5, show_default=True,
              help="Of each kind, over the same ground.")  # fmt: skip
@click.option("--late", "lates", type=click.FloatRange(min=0.0), multiple=True,
              default=(0.0, 12.0, float("inf")), show_default=True,
              help="When navigation gets the map, s; inf: never. May be given again.")  # fmt: skip
@click.option("--start", "starts", type=click.FloatRange(min=1e-3), multiple=True,
              help="Error of position at the start, 1 sigma an axis, m; may be given again. "
              "Left out: the scenario's.")  # fmt: skip
@click.option("--policy", default="safest", show_default=True, help="Retargeting policy.")
@seed_and_jobs
def main(
    scenario: str, flights: int, lates: tuple[float, ...], starts: tuple[float, ...], policy: str,
    seed: int, jobs: int,
) -> None:  # fmt: skip
    """Hand the map over early, late or never, and see how the lander comes down."""
    console = plain_console(150)
    flown: dict[str, list[Flown]] = {}
    for start in starts or (None,):
        for late in lates:
            tasks = [Task(late, start, scenario, n, seed, policy) for n in range(flights)]
            name = f"{late:g} s" + ("" if start is None else f", {start:g} m")
            flown[name] = gathered(fly, tasks, jobs, console, name)
    console.print(summary(flown))


if __name__ == "__main__":
    main()
