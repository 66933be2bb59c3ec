r"""Compare landings with an early, a late and no lock on the prior map.

A lock is the first accepted position of the lander on the map. The script flies `morpheus.toml`
over the same fields, with the map available to navigation from the start, later, or never, and with
the initial error of the scenario or a larger one. Terrain is mapped in the local frame from the
first scan, and the policy decides on that map with or without a lock. Paired flights differ only in
the lock.

python scenarios/navigation/late_lock.py --flights 10 --map-time 0 --map-time 12 --map-time 24 \
    --map-time inf
python scenarios/navigation/late_lock.py --flights 10 --position-sigma 0.01 \
    --position-sigma 100 --map-time inf
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table
from scipy.stats import binomtest

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.studies import Case, Proportion, Report, Study, run_script

SCENARIOS = Path(__file__).resolve().parents[1]


def fly_variants(case: Case) -> list[dict[str, Any]]:
    """Simulate one flight with each initial error and each time of map availability."""
    return [
        fly(case, start, map_time)
        for start in case["position_sigma"] or (None,) for map_time in case["map_time"]
    ]  # fmt: skip


def fly(case: Case, position_sigma: float | None, map_time: float) -> dict[str, Any]:
    """Simulate one flight in which navigation receives the prior map at a given time.

    `position_sigma` is the initial position error, 1 sigma per axis, m; None: that of the scenario.
    `map_time` is in s; infinite: never.

    The row has the time of the first lock (s; NaN: never), the displacement of the landing site in
    the onboard frame at the lock (m), the maximum change of the position estimate in one cycle
    minus the distance flown (m), the number of retargeting decisions with a map, the distance
    between touchdown and selected site (m), the maximum position error over the axes at the end in
    standard deviations, whether navigation declared itself lost at the end, and whether the landing
    was safe.
    """
    scenario = Scenario.load(Path(case["scenario"]))
    if position_sigma is not None:
        scenario = scenario.changed(initial_uncertainty={"position_m": position_sigma})
    simulation = Simulation(scenario, flight_seed(case.seed, case.number), case["policy"])
    computer = simulation.computer
    navigation = computer.navigation
    if not isinstance(navigation, Navigator) or navigation.matcher is None:
        raise click.UsageError(
            f"{case['scenario']}: must contain the table [prior_map] for navigation"
        )
    matcher = navigation.processors.pop(navigation.processors.index(navigation.matcher))
    jumped, decisions, sigmas = 0.0, 0, np.nan
    while not simulation.done:
        if matcher not in navigation.processors and simulation.time >= map_time:
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
    return {
        "variant": f"{map_time:g} s"
        + ("" if position_sigma is None else f", {position_sigma:g} m"),
        "lock_s": locks[0].time if locks else np.nan,
        "site_displacement_m": locks[0].details["moved"] if locks else np.nan,
        "max_jump_m": jumped, "decisions": decisions,
        "miss_m": np.nan
        if touchdown is None else float(np.hypot(*(touchdown.position - aimed)[:2])),
        "error_sigmas": sigmas, "lost": simulation.estimate.lost, "safe": simulation.outcome.safe,
    }  # fmt: skip


def max_error_sigma(simulation: Simulation) -> float:
    """Return the maximum position error over the axes, in standard deviations."""
    error = np.abs(simulation.site_error)
    return float((error / np.sqrt(np.diag(simulation.estimate.covariance)[:3])).max())


def print_landings(report: Report) -> None:
    """Print landing results by time of map availability and initial error.

    A variant is a combination of these two. From the second variant on, a row counts the flights in
    which only this variant or only the first one landed safely, with the p-value of a sign test.
    """
    table = Table(title="Landings by the time at which the map becomes available")
    for heading in ("map available from, initial error", "flights with\na lock",
    "lock time,\nmedian (s)",
                    "site displacement\nat the lock (m)", "estimate jump,\nmaximum (m)",
                    "decisions,\nmedian", "touchdown miss,\nmedian, max (m)",
                    "over 5 sigma,\nnot declared lost", "safe landings",
                    "against the first:\nbetter, worse (p)"):  # fmt: skip
        table.add_column(heading, justify="right")
    groups = report.groups("variant")
    first = [f["safe"] for f in next(iter(groups.values()))]
    for n, ((name,), mine) in enumerate(groups.items()):
        found = [f for f in mine if np.isfinite(f["lock_s"])]
        safe = [f["safe"] for f in mine]
        low, high = Proportion(sum(safe), len(safe)).interval
        won = sum(a and not b for a, b in zip(safe, first, strict=True))
        lost = sum(b and not a for a, b in zip(safe, first, strict=True))
        p = binomtest(won, won + lost).pvalue if won + lost else 1.0
        missed = report.column("miss_m", mine)
        table.add_row(
            name, f"{len(found)}",
            f"{np.median(report.column('lock_s', found)):.1f}" if found else "",
            f"{np.median(report.column('site_displacement_m', found)):.1f}" if found else "",
            f"{max(f['max_jump_m'] for f in mine):.2f}",
            f"{np.median([f['decisions'] for f in mine]):.0f}",
            f"{np.nanmedian(missed):.2f}, {np.nanmax(missed):.2f}",
            f"{sum(f['error_sigmas'] > 5.0 and not f['lost'] for f in mine)}",
            f"{sum(safe)} of {len(safe)} [{low:.2f}, {high:.2f}]",
            "" if n == 0 else f"{won}, {lost} ({p:.2f})",
        )  # fmt: skip
    report.print(table)


study = Study(
    fly_variants,
    repeats="flights",
    count=5,
    options=(
        click.Option(
            ["--scenario"], type=click.Path(exists=True, dir_okay=False),
            default=str(SCENARIOS / "morpheus.toml"), show_default="morpheus.toml",
            help="Scenario to fly (TOML file); it must have a prior map.",
        ),
        click.Option(
            ["--map-time"], type=click.FloatRange(min=0.0), multiple=True,
            default=(0.0, 12.0, float("inf")), show_default=True,
            help="Time in the flight from which the prior map is available (s); inf: never. "
            "Repeat the option for several times.",
        ),
        click.Option(
            ["--position-sigma"], type=click.FloatRange(min=1e-3), multiple=True, default=(),
            help="Initial position error, 1 sigma per axis (m); repeat the option for several "
            "values (default: value of the scenario).",
        ),
        click.Option(
            ["--policy"], default="safest", show_default=True,
            help="Policy that selects the landing site: a name from `lunarsim parts policy`.",
        ),
    ),
    report=print_landings,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
