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
python scenarios/navigation/instruments_or_fixes.py --flights 10 --scenario golombek
"""

from __future__ import annotations

import time
from typing import Any

import click
import numpy as np
from navigation_errors import SCENARIOS
from rich.table import Table
from scipy.stats import binomtest

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.studies import Case, Proportion, Report, Study, run_script

SCENARIO_NAMES = ("apollo15", "golombek", "highland", "hirise", "mare")
WAYS = ("fixes", "inertial")
FIXES = {
    "altimeter": None,
    "velocimeter": None,
    "stars": None,
    "fix": {"kind": "navigation-fix"},
}


def scenario_of(name: str, navigation: str) -> Scenario:
    """Load a scenario; if `navigation` is "fixes", use fixes instead of instruments.

    `name` is the file name without extension.
    """
    scenario = Scenario.load(SCENARIOS / f"{name}.toml")
    if scenario.terrain.kind == "fractal":
        # The published results are for terrain without detail below its grid spacing.
        scenario = scenario.changed(terrain={"detail_m": 0.0})
    return scenario.changed(sensors=FIXES) if navigation == "fixes" else scenario


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight; measure the distance of touchdown from the selected site.

    The row has the horizontal miss of the site (m; NaN without a touchdown), its value expected at
    the last decision (1 sigma per axis, m), the position error at the end (m), whether navigation
    ended lost, the number of `covariance-inflated` events, and the wall time of the flight without
    terrain generation (s).
    """
    simulation = Simulation(
        scenario_of(case["scenario"], case["navigation"]),
        flight_seed(case.seed, case.number), case["policy"],
    )  # fmt: skip
    start_s = time.perf_counter()
    flight = simulation.run()
    seconds = time.perf_counter() - start_s
    touchdown = flight.outcome.touchdown
    miss = np.nan
    if touchdown is not None:
        there = flight.sites[-1] - flight.map_error
        miss = float(np.linalg.norm((touchdown.position - there)[:2]))
    names = [event["name"] for event in flight.events]
    return {
        "safe": flight.outcome.safe, "failed": ", ".join(flight.outcome.failure_causes),
        "miss_m": miss, "expected_m": simulation.computer.expected_miss,
        "error_m": float(np.linalg.norm(simulation.navigation_error)),
        "lost": simulation.computer.estimate.lost,
        "inflated": names.count("covariance-inflated"), "seconds": seconds,
    }  # fmt: skip


def miss_texts(miss: np.ndarray, expected: np.ndarray) -> tuple[str, str]:
    """Format the distances of touchdowns from the site and their expected values.

    `miss` and `expected` are (n,), m. Returns two texts: median, 95th percentile and maximum miss
    (m); median expected miss (m) and RMS of the ratio of miss to expectation. Without a touchdown
    they are "no touchdown" and "".
    """
    down = miss[np.isfinite(miss)]
    if len(down) == 0:
        return "no touchdown", ""
    known = np.isfinite(miss) & np.isfinite(expected)
    over = ""
    if known.any():
        ratio = np.sqrt(0.5 * np.mean((miss[known] / expected[known]) ** 2))
        over = f"{np.median(expected[known]):.2f}, {ratio:.2f}"
    return f"{np.median(down):.2f}, {np.quantile(down, 0.95):.2f}, {down.max():.2f}", over


def print_landings(report: Report) -> None:
    """Print landing results by scenario and kind of navigation.

    The failed landings are listed below the table.
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
    flights = report.groups("scenario", "navigation")
    for (name, way), mine in flights.items():
        landed = Proportion(sum(f["safe"] for f in mine), len(mine))
        low, high = landed.interval
        pairs = ""
        if way == "inertial" and (name, "fixes") in flights:
            both = list(zip(mine, flights[name, "fixes"], strict=False))
            won = sum(a["safe"] and not b["safe"] for a, b in both)
            lost = sum(b["safe"] and not a["safe"] for a, b in both)
            p = binomtest(won, won + lost).pvalue if won + lost else 1.0
            pairs = f"{won}, {lost} ({p:.2f})"
        table.add_row(
            name, way, f"{landed.count} of {landed.total} [{low:.2f}, {high:.2f}]", pairs,
            *miss_texts(report.column("miss_m", mine), report.column("expected_m", mine)),
            f"{sum(f['inflated'] for f in mine)}, {sum(f['lost'] for f in mine)}",
            f"{np.median(report.column('seconds', mine)):.2f}",
            f"{np.median(report.column('error_m', mine)):.2f}",
        )  # fmt: skip
    report.print(table)
    for f in report.rows:
        if not f["safe"]:
            name, way, n = f["scenario"], f["navigation"], f["number"]
            report.print(f"{name}, {way}, flight {n}: {f['failed']}")


study = Study(
    fly,
    repeats="flights",
    count=10,
    factors={"scenario": SCENARIO_NAMES, "navigation": WAYS},
    factor_help={
        "scenario": "Name of a scenario.",
        "navigation": "Position fixes, or onboard instruments (inertial).",
    },
    options=(
        click.Option(
            ["--policy"], default="safest", show_default=True,
            help="Policy that selects the landing site: a name from `lunarsim parts policy`.",
        ),
    ),
    report=print_landings,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
