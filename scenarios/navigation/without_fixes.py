"""What it costs to fly by own instruments where a scenario gives fixes: paired flights.

Each scenario is flown twice over the same ground, from the same starts: with the fixes that it
names (truth plus a budget), and with a radar altimeter, a Doppler velocimeter and a star tracker in
one filter instead (`kind = "inertial"`), started as far off as the budget of the fixes says.

The miss is where the lander touched down less where the site that it flew to truly is, by the map
that decided: what decisions expect as `touchdown_sigma`. What is left of an error that map and
lander share does no harm and is in the last column alone.

python scenarios/navigation/without_fixes.py --flights 10
python scenarios/navigation/without_fixes.py --flights 10 --only golombek
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import click
import numpy as np
from consistency import SCENARIOS
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from lunarsim.campaign.pool import gathered
from lunarsim.evaluation.statistics import Proportion
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

FLOWN = ("apollo15", "golombek", "highland", "hirise")
WAYS = ("fixes", "inertial")
INSTRUMENTS = {
    "fix": None,
    "altimeter": {"kind": "radar-altimeter"},
    "velocimeter": {"kind": "velocimeter"},
    "stars": {"kind": "star-tracker"},
}


@dataclass(frozen=True)
class Task:
    """One flight."""

    scenario: str
    way: str
    flight: int
    seed: int
    policy: str


@dataclass(frozen=True)
class Flown:
    """What came of it.

    Attributes
    ----------
    safe, failed
        Whether the lander came down safely, and why not.
    miss
        Over the ground, from the site on the map that decided, m; NaN without a touchdown.
    error
        Of the position at the end, m.
    lost, doubted
        Whether navigation ended lost, and how often it doubted a measurement.
    seconds
        Wall time of the flight, its world left out.
    """

    safe: bool
    failed: str
    miss: float
    error: float
    lost: bool
    doubted: int
    seconds: float


def scenario_of(name: str, way: str) -> Scenario:
    """Return a scenario with its fixes, or with instruments of its own."""
    scenario = Scenario.load(SCENARIOS / f"{name}.toml")
    if way == "fixes":
        return scenario
    return scenario.changed(sensors=INSTRUMENTS, navigation={"kind": "inertial"})


def fly(task: Task) -> Flown:
    """Fly once."""
    simulation = Simulation(
        scenario_of(task.scenario, task.way), flight_seed(task.seed, task.flight), task.policy
    )
    begun = time.perf_counter()
    flight = simulation.run()
    seconds = time.perf_counter() - begun
    touchdown = flight.verdict.touchdown
    miss = np.nan
    if touchdown is not None:
        there = flight.sites[-1] - flight.map_error
        miss = float(np.linalg.norm((touchdown.position - there)[:2]))
    names = [event["name"] for event in flight.events]
    return Flown(
        flight.verdict.safe, ", ".join(flight.verdict.failed), miss,
        float(np.linalg.norm(simulation.navigation_error)), simulation.computer.estimate.lost,
        names.count("doubted"), seconds,
    )  # fmt: skip


def table_of(flown: dict[tuple[str, str], list[Flown]]) -> Table:
    """Return a row a scenario and way."""
    table = Table(title="Fixes against own instruments, over the same ground")
    for left in ("scenario", "navigation"):
        table.add_column(left)
    for heading in ("landed safe", "inertial alone,\nfixes alone (p)",
                    "miss of the site (m)\nmedian, 95 %, most", "doubted,\nlost",
                    "s a flight,\nmedian", "position off at the\nend, median (m)"):  # fmt: skip
        table.add_column(heading, justify="right")
    for (name, way), mine in flown.items():
        landed = Proportion(sum(f.safe for f in mine), len(mine))
        low, high = landed.interval
        pairs = ""
        if way == "inertial":
            both = list(zip(mine, flown[name, "fixes"], strict=True))
            won = sum(a.safe and not b.safe for a, b in both)
            lost = sum(b.safe and not a.safe for a, b in both)
            p = binomtest(won, won + lost).pvalue if won + lost else 1.0
            pairs = f"{won}, {lost} ({p:.2f})"
        miss = np.array([f.miss for f in mine])
        miss = miss[np.isfinite(miss)]
        spread = "none came down" if len(miss) == 0 else (
            f"{np.median(miss):.2f}, {np.quantile(miss, 0.95):.2f}, {miss.max():.2f}"
        )  # fmt: skip
        table.add_row(
            name, way, f"{landed.count} of {landed.total} [{low:.2f}, {high:.2f}]", pairs, spread,
            f"{sum(f.doubted for f in mine)}, {sum(f.lost for f in mine)}",
            f"{np.median([f.seconds for f in mine]):.2f}",
            f"{np.median([f.error for f in mine]):.2f}",
        )  # fmt: skip
    return table


@click.command()
@click.option(
    "--flights", type=click.IntRange(min=1), default=10, show_default=True,
    help="Of each scenario in each way.",
)  # fmt: skip
@click.option(
    "--only", type=click.Choice(FLOWN), multiple=True,
    help="Scenario; may be given again. Left out: all that fly by fixes.",
)  # fmt: skip
@click.option("--policy", default="safest", show_default=True, help="Retargeting policy.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed.")
@click.option(
    "--jobs", type=click.IntRange(min=1), default=1, show_default=True,
    help="Processes; only wall times depend on it.",
)  # fmt: skip
def main(flights: int, only: tuple[str, ...], policy: str, seed: int, jobs: int) -> None:
    """Fly scenarios with fixes and with instruments of their own, and compare."""
    console = Console(width=160)
    flown: dict[tuple[str, str], list[Flown]] = {}
    for name in only or FLOWN:
        for way in WAYS:
            tasks = [Task(name, way, n, seed, policy) for n in range(flights)]
            flown[name, way] = gathered(fly, tasks, jobs, console, f"{name}, {way}")
    console.print(table_of(flown))
    for (name, way), mine in flown.items():
        for n, f in enumerate(mine):
            if not f.safe:
                console.print(f"{name}, {way}, flight {n}: {f.failed}")


if __name__ == "__main__":
    main()
