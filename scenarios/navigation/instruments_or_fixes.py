"""Compare landings with onboard instruments and with position fixes.

Each scenario is flown twice over the same terrain from the same starts: as it is, with a radar
altimeter, a Doppler velocimeter and a star tracker in one filter; and with position fixes (true
position and velocity plus errors as large as the initial errors of the first).

The miss is the distance from the touchdown to the true position of the selected site, according to
the hazard map used for the decision. The table also gives the miss expected at the last decision
(`expected_miss`) and the root mean square of the ratio per axis, which is 1 if the expectation is
correct. An error that map and vehicle have in common has no effect on the miss; it appears only in
the last column.

python scenarios/navigation/instruments_or_fixes.py --flights 10
python scenarios/navigation/instruments_or_fixes.py --flights 10 --only golombek
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import click
import numpy as np
from consistency import SCENARIOS
from rich.table import Table
from scipy.stats import binomtest

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion

SCENARIO_NAMES = ("apollo15", "golombek", "highland", "hirise", "mare")
WAYS = ("fixes", "inertial")
FIXES = {
    "altimeter": None,
    "velocimeter": None,
    "stars": None,
    "fix": {"kind": "navigation-fix"},
}


@dataclass(frozen=True)
class FixesComparisonTask:
    """Settings of one simulated flight with onboard instruments or position fixes.

    `scenario` is a scenario name, `navigation` a name in `WAYS` ("fixes" or "inertial"). `flight`
    and `seed` (root seed) determine the random numbers; `policy` selects the landing sites.
    """

    scenario: str
    navigation: str
    flight: int
    seed: int
    policy: str


@dataclass(frozen=True)
class FixesComparisonFlight:
    """Results of one simulated flight with onboard instruments or position fixes.

    Attributes
    ----------
    safe, failed
        Whether the landing was safe, and the failed criteria.
    miss
        Horizontal distance of the touchdown from the selected site, m; NaN without a touchdown.
    expected
        Expected miss at the last decision, 1 sigma per axis, m.
    error
        Position error at the end, m.
    lost, inflated
        Whether navigation ended lost, and the number of `covariance-inflated` events.
    seconds
        Wall time of the flight without terrain generation, s.
    """

    safe: bool
    failed: str
    miss: float
    expected: float
    error: float
    lost: bool
    inflated: int
    seconds: float


def scenario_of(name: str, navigation: str) -> Scenario:
    """Load a scenario; if `navigation` is "fixes", use fixes instead of instruments.

    `name` is the file name without extension.
    """
    scenario = Scenario.load(SCENARIOS / f"{name}.toml")
    if scenario.terrain.kind == "fractal":
        # The published results are for terrain without detail below its grid spacing.
        scenario = scenario.changed(terrain={"detail_m": 0.0})
    return scenario.changed(sensors=FIXES) if navigation == "fixes" else scenario


def fly(task: FixesComparisonTask) -> FixesComparisonFlight:
    """Simulate one flight; measure the distance of touchdown from the selected site."""
    simulation = Simulation(
        scenario_of(task.scenario, task.navigation),
        flight_seed(task.seed, task.flight),
        task.policy,
    )
    start_s = time.perf_counter()
    flight = simulation.run()
    seconds = time.perf_counter() - start_s
    touchdown = flight.outcome.touchdown
    miss = np.nan
    if touchdown is not None:
        there = flight.sites[-1] - flight.map_error
        miss = float(np.linalg.norm((touchdown.position - there)[:2]))
    names = [event["name"] for event in flight.events]
    return FixesComparisonFlight(
        flight.outcome.safe, ", ".join(flight.outcome.failure_causes), miss,
        simulation.computer.expected_miss,
        float(np.linalg.norm(simulation.navigation_error)), simulation.computer.estimate.lost,
        names.count("covariance-inflated"), seconds,
    )  # fmt: skip


def miss_texts(flights: list[FixesComparisonFlight]) -> tuple[str, str]:
    """Format the distances of touchdowns from the site, and their expected values.

    Returns two texts: median, 95th percentile and maximum miss (m); median expected miss (m) and
    RMS of the ratio of miss to expectation.
    """
    miss, expected = np.array([(f.miss, f.expected) for f in flights]).T
    down = miss[np.isfinite(miss)]
    if len(down) == 0:
        return "no touchdown", ""
    known = np.isfinite(miss) & np.isfinite(expected)
    over = ""
    if known.any():
        ratio = np.sqrt(0.5 * np.mean((miss[known] / expected[known]) ** 2))
        over = f"{np.median(expected[known]):.2f}, {ratio:.2f}"
    return f"{np.median(down):.2f}, {np.quantile(down, 0.95):.2f}, {down.max():.2f}", over


def table_of(flights: dict[tuple[str, str], list[FixesComparisonFlight]]) -> Table:
    """Return the table of landing results by scenario and kind of navigation.

    `flights` holds the flights by scenario name and navigation ("fixes" or "inertial").
    """
    table = Table(title="Onboard instruments compared with fixes over the same terrain")
    for left in ("scenario", "navigation"):
        table.add_column(left)
    for heading in ("safe landings", "only inertial safe,\nonly fixes safe (p)",
                    "miss of the site (m)\nmedian, 95th pct., max",
                    "expected miss (m),\nRMS of miss / expected",
                    "inflated,\nlost", "time per flight,\nmedian (s)",
                    "final position error,\nmedian (m)"):  # fmt: skip
        table.add_column(heading, justify="right")
    for (name, way), mine in flights.items():
        landed = Proportion(sum(f.safe for f in mine), len(mine))
        low, high = landed.interval
        pairs = ""
        if way == "inertial":
            both = list(zip(mine, flights[name, "fixes"], strict=True))
            won = sum(a.safe and not b.safe for a, b in both)
            lost = sum(b.safe and not a.safe for a, b in both)
            p = binomtest(won, won + lost).pvalue if won + lost else 1.0
            pairs = f"{won}, {lost} ({p:.2f})"
        table.add_row(
            name, way, f"{landed.count} of {landed.total} [{low:.2f}, {high:.2f}]", pairs,
            *miss_texts(mine),
            f"{sum(f.inflated for f in mine)}, {sum(f.lost for f in mine)}",
            f"{np.median([f.seconds for f in mine]):.2f}",
            f"{np.median([f.error for f in mine]):.2f}",
        )  # fmt: skip
    return table


@click.command()
@click.option(
    "--flights", type=click.IntRange(min=1), default=10, show_default=True,
    help="Number of flights for each combination of scenario and kind of navigation.",
)  # fmt: skip
@click.option(
    "--only", type=click.Choice(SCENARIO_NAMES), multiple=True,
    help="Name of a scenario to fly; repeat the option for several scenarios (default: all).",
)  # fmt: skip
@click.option(
    "--policy",
    default="safest",
    show_default=True,
    help="Policy that selects the landing site: a name from `lunarsim parts policy`.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option(
    "--jobs", type=click.IntRange(min=1), default=1, show_default=True,
    help="Number of parallel processes; it changes only the run times.",
)  # fmt: skip
def main(flights: int, only: tuple[str, ...], policy: str, seed: int, jobs: int) -> None:
    """Compare landings with onboard instruments and with position fixes, by scenario."""
    console = plain_console(160)
    flown: dict[tuple[str, str], list[FixesComparisonFlight]] = {}
    for name in only or SCENARIO_NAMES:
        for way in WAYS:
            tasks = [FixesComparisonTask(name, way, n, seed, policy) for n in range(flights)]
            flown[name, way] = collect_results(fly, tasks, jobs, console, f"{name}, {way}")
    console.print(table_of(flown))
    for (name, way), mine in flown.items():
        for n, f in enumerate(mine):
            if not f.safe:
                console.print(f"{name}, {way}, flight {n}: {f.failed}")


if __name__ == "__main__":
    main()
