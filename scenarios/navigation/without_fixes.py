"""What it costs to fly by own instruments and not by fixes: paired flights.

Each scenario is flown twice over the same ground, from the same starts: as it is, with a radar
altimeter, a Doppler velocimeter and a star tracker in one filter, and with fixes instead (truth
plus a budget of errors, the same as at the start of the other).

The miss is where the lander touched down less where the site that it flew to truly is, by the map
that decided. Beside it stands what the last decision expected of it (`expected_miss`), and the root
of the mean square of the one over the other, an axis: 1 if misses are what is expected. What is
left of an error that map and lander share does no harm and is in the last column alone.

python scenarios/navigation/without_fixes.py --flights 10
python scenarios/navigation/without_fixes.py --flights 10 --only golombek
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import click
import numpy as np
from consistency import SCENARIOS
from rich.table import Table
from scipy.stats import binomtest

from lunarsim.campaign.pool import gathered
from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

FLOWN = ("apollo15", "golombek", "highland", "hirise", "mare")
WAYS = ("fixes", "inertial")
FIXES = {
    "altimeter": None,
    "velocimeter": None,
    "stars": None,
    "fix": {"kind": "navigation-fix"},
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
    expected
        Of the miss, at the last decision, 1 sigma an axis, m.
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
    expected: float
    error: float
    lost: bool
    doubted: int
    seconds: float


def scenario_of(name: str, way: str) -> Scenario:
    """Return a scenario as it is, or with fixes."""
    scenario = Scenario.load(SCENARIOS / f"{name}.toml")
    if scenario.terrain.kind == "fractal":
        # Published figures are of ground without detail below its posts.
        scenario = scenario.changed(terrain={"detail_m": 0.0})
    return scenario.changed(sensors=FIXES) if way == "fixes" else scenario


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
        simulation.computer.expected_miss,
        float(np.linalg.norm(simulation.navigation_error)), simulation.computer.estimate.lost,
        names.count("doubted"), seconds,
    )  # fmt: skip


def misses(mine: list[Flown]) -> tuple[str, str]:
    """Return how far sites were missed, and how that compares with what was expected."""
    miss, expected = np.array([(f.miss, f.expected) for f in mine]).T
    down = miss[np.isfinite(miss)]
    if len(down) == 0:
        return "none came down", ""
    told = np.isfinite(miss) & np.isfinite(expected)
    over = ""
    if told.any():
        ratio = np.sqrt(0.5 * np.mean((miss[told] / expected[told]) ** 2))
        over = f"{np.median(expected[told]):.2f}, {ratio:.2f}"
    return f"{np.median(down):.2f}, {np.quantile(down, 0.95):.2f}, {down.max():.2f}", over


def table_of(flown: dict[tuple[str, str], list[Flown]]) -> Table:
    """Return a row a scenario and way."""
    table = Table(title="Fixes against own instruments, over the same ground")
    for left in ("scenario", "navigation"):
        table.add_column(left)
    for heading in ("landed safe", "inertial alone,\nfixes alone (p)",
                    "miss of the site (m)\nmedian, 95 %, most", "expected,\nrms of miss over it",
                    "doubted,\nlost", "s a flight,\nmedian",
                    "position off at the\nend, median (m)"):  # fmt: skip
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
        table.add_row(
            name, way, f"{landed.count} of {landed.total} [{low:.2f}, {high:.2f}]", pairs,
            *misses(mine),
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
    help="Scenario; may be given again. Left out: all of them.",
)  # fmt: skip
@click.option("--policy", default="safest", show_default=True, help="Retargeting policy.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed.")
@click.option(
    "--jobs", type=click.IntRange(min=1), default=1, show_default=True,
    help="Processes; only wall times depend on it.",
)  # fmt: skip
def main(flights: int, only: tuple[str, ...], policy: str, seed: int, jobs: int) -> None:
    """Fly scenarios with fixes and with instruments of their own, and compare."""
    console = plain_console(160)
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
