r"""Check navigation consistency (NEES, NIS) and the effect of initial errors.

The script flies a scenario whose navigation has an error state. At five fixed fractions of the
planned descent time it compares the errors of position, velocity and attitude with their covariance
(NEES), and the innovations of each kind of measurement with theirs (NIS): those of the last
measurement before each epoch, and those of all measurements since the previous epoch. The second
set is larger and therefore more sensitive, but not independent; the bounds assume independence.
With `--position-sigma` given twice or more, each flight is repeated with each initial position
error over the same terrain.

python scenarios/navigation/consistency.py --flights 50 --jobs 2
python scenarios/navigation/consistency.py --flights 50 --position-sigma 0.01 --position-sigma 100
python scenarios/navigation/consistency.py --flights 50 --kind inertial --kind ukf
python scenarios/navigation/consistency.py --flights 50 --scenario scenarios/shadow_nominal.toml
python scenarios/navigation/consistency.py --flights 20 --without stars --velocity-sigma 1 \
    --velocity-sigma 10
python scenarios/navigation/consistency.py --scenario scenarios/morpheus.toml \
    --set sensors.flash.range_sigma_m=0.1
python scenarios/navigation/consistency.py --scenario scenarios/camera_and_lidar.toml --flights 50 \
    --set navigation.terrain_slope_deg=0.5 --set initial_uncertainty.target_elevation_m=5 \
    --check 1 --seed 1201
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise, product
from pathlib import Path

import click
import numpy as np
from consistency_bounds import EPOCHS, PARTS, Row, inconsistencies, nees_table, nis_table
from navigation_errors import SCENARIOS, corrects_state, error_of, nis_sums, subtract_sums
from rich.table import Table
from scipy.stats import binomtest

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.evaluation.consistency import Consistency, normalised_squared_error
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.unscented import UnscentedFilter
from lunarsim.scenario.changes import with_changes
from lunarsim.studies import Case, Proportion, Report, Study, run_script


def fly_variants(case: Case) -> list[Row]:
    """Simulate one flight with each kind of navigation and each initial error."""
    variants = product(*(case[name] or (None,) for name in VARIED))
    return [fly(case, *variant) for variant in variants]


def fly(
    case: Case, kind: str | None, position_sigma: float | None, velocity_sigma: float | None
) -> Row:
    """Simulate one flight and record navigation errors, covariances and innovations.

    `kind` is the kind of navigation; `position_sigma` (m) and `velocity_sigma` (m/s) replace the
    initial uncertainty, 1 sigma per axis; None: that of the scenario.

    The row has the errors of position (m), velocity (m/s) and attitude (rad), ENU, at the e epochs
    (e, 9), their covariance (e, 9, 9) and standard deviations (e, 9), and the mean NEES per degree
    of freedom by part of the state. It has sums of normalised squared innovations (NIS) with their
    degrees of freedom by kind of measurement: of the last cycle with a measurement before each
    epoch (`nis_last`) and of all cycles since the previous epoch (`nis_at`); and NIS per degree of
    freedom over the flight (`nis`). `start_error` and `map_error` are position errors at the start
    and at touchdown, m.
    """
    scenario = with_changes(Scenario.load(Path(case["scenario"])), case["changes"])
    if position_sigma is not None:
        scenario = scenario.changed(initial_uncertainty={"position_m": position_sigma})
    if velocity_sigma is not None:
        scenario = scenario.changed(initial_uncertainty={"velocity_m_s": velocity_sigma})
    if case["without"]:
        scenario = scenario.changed(sensors=dict.fromkeys(case["without"]))
    if kind is not None:
        scenario = scenario.changed(navigation={"kind": kind})
    simulation = Simulation(scenario, flight_seed(case.seed, case.number), case["policy"])
    navigation = simulation.computer.navigation
    if not isinstance(navigation, Navigator | UnscentedFilter):
        raise click.UsageError(f"{case['scenario']}: navigation.kind must be 'inertial' or 'ukf'")
    planned = simulation.computer.time_to_go
    due = [share * planned for share in EPOCHS]
    errors, covariances, before, latest = [], [], [], []
    last: dict[str, Consistency] = {}
    start = float(np.linalg.norm(error_of(simulation)[:3]))
    while not simulation.done:
        already = nis_sums(navigation)
        simulation.step()
        new = subtract_sums(already, nis_sums(navigation))
        last |= {kind: c for kind, c in new.items() if c.degrees}
        if due and not simulation.done and simulation.time >= due[0] - 1e-9:
            due.pop(0)
            errors.append(error_of(simulation))
            covariances.append(simulation.estimate.covariance)
            before.append(nis_sums(navigation))
            latest.append(last)
            last = {}
    names = [name for _, name, _ in simulation.computer.telemetry]
    monitors = {k: w for k, w in navigation.monitors.items() if corrects_state(k)}
    name = "the scenario's" if position_sigma is None else f"{position_sigma:g}"
    name += "" if velocity_sigma is None else f", {velocity_sigma:g} m/s"
    name += "" if kind is None else f", {kind}"
    return {
        "variant": name, "error": errors, "covariance": covariances,
        "sigma": [np.sqrt(np.diag(c)) for c in covariances],
        "nees": {part: mean_nees(errors, covariances, keep) for part, keep in PARTS.items()},
        "nis": {kind: c.ratio for kind, c in nis_sums(navigation).items() if c.degrees},
        "nis_at": [plain_sums(subtract_sums(a, b)) for a, b in pairwise(({}, *before))],
        "nis_last": [plain_sums(at) for at in latest],
        "rejected": {kind: monitor.rejected_count for kind, monitor in monitors.items()},
        "inflated": names.count("covariance-inflated"),
        "lost": simulation.computer.estimate.lost, "ever_lost": "lost" in names,
        "start_error": start, "map_error": float(np.linalg.norm(simulation.navigation_error)),
        "safe": simulation.outcome.safe,
    }  # fmt: skip


def plain_sums(sums: Mapping[str, Consistency]) -> dict[str, list[float]]:
    """Return the sums of NIS as lists of sum and degrees of freedom, by kind."""
    return {kind: [c.total, c.degrees] for kind, c in sums.items()}


def mean_nees(
    errors: Iterable[np.ndarray], covariances: Iterable[np.ndarray], components: np.ndarray
) -> float | None:
    """Return the mean NEES of selected errors per degree of freedom, over epochs.

    `errors` (9,) and `covariances` (9, 9) are those of one flight at each epoch, and `components`
    the selected indices. Without epochs, the result is None.
    """
    squares = [
        normalised_squared_error(error[components], covariance[np.ix_(components, components)])
        for error, covariance in zip(errors, covariances, strict=True)
    ]
    return sum(squares) / (len(components) * len(squares)) if squares else None


def landing_table(flights_by_variant: Mapping[str, Sequence[Row]]) -> Table:
    """Return the table of landing results by variant of the study.

    A variant is a combination of initial error and kind of navigation. From the second variant on,
    a row counts the flights in which only this variant or only the first one landed safely, with
    the p-value of a sign test.
    """
    table = Table(title="Landings")
    for heading in ("initial error\n(1 sigma per axis, m), kind", "initial error,\nmedian (m)",
                    "touchdown error,\nmedian (m)", "safe landings",
                    "against the first:\nbetter, worse (p)",
                    "suspect\nmeasurements", "lost at the\nend, ever"):  # fmt: skip
        table.add_column(heading, justify="right")
    first = [f["safe"] for f in next(iter(flights_by_variant.values()))]
    for n, (start, flights) in enumerate(flights_by_variant.items()):
        mine = [f["safe"] for f in flights]
        landed = Proportion(sum(mine), len(mine))
        low, high = landed.interval
        won = sum(a and not b for a, b in zip(mine, first, strict=True))
        lost = sum(b and not a for a, b in zip(mine, first, strict=True))
        p = binomtest(won, won + lost).pvalue if won + lost else 1.0
        table.add_row(
            start, f"{np.median([f['start_error'] for f in flights]):.1f}",
            f"{np.median([f['map_error'] for f in flights]):.1f}",
            f"{sum(mine)} of {len(mine)} [{low:.2f}, {high:.2f}]",
            "" if n == 0 else f"{won}, {lost} ({p:.2f})",
            f"{sum(f['inflated'] for f in flights)}",
            f"{sum(f['lost'] for f in flights)}, {sum(f['ever_lost'] for f in flights)}",
        )  # fmt: skip
    return table


def print_consistency(report: Report) -> None:
    """Print NEES, NIS and landings; with `--check`, also the inconsistencies.

    If there are inconsistencies, the command exits with status 1.
    """
    by_variant = {name: rows for (name,), rows in report.groups("variant").items()}
    for name, rows in by_variant.items():
        report.print(f"Initial error: {name}")
        report.print(nees_table(rows))
        report.print(nis_table(rows, "nis_last", "of the last measurement before each epoch"))
        report.print(nis_table(rows, "nis_at", "of all measurements since the previous epoch"))
    report.print(landing_table(by_variant))
    factor = report.options["lower_factor"]
    if factor is None:
        return
    wrong = [f"{name}: {w}" for name, rows in by_variant.items()
             for w in inconsistencies(rows, factor)]  # fmt: skip
    for line in wrong:
        report.print(line)
    if wrong:
        raise click.exceptions.Exit(1)


VARIED = ("kind", "position_sigma", "velocity_sigma")
study = Study(
    fly_variants,
    repeats="flights",
    count=10,
    minimum=2,
    options=(
        click.Option(
            ["--scenario"], type=click.Path(exists=True, dir_okay=False),
            default=str(SCENARIOS / "instruments.toml"), show_default="instruments.toml",
            help="Scenario to fly (TOML file).",
        ),
        click.Option(
            ["--position-sigma"], type=click.FloatRange(min=1e-3), multiple=True, default=(),
            help="Initial position error, 1 sigma per axis (m); repeat the option for several "
            "values (default: value of the scenario).",
        ),
        click.Option(
            ["--kind"], type=click.Choice(("inertial", "ukf")), multiple=True, default=(),
            help="Kind of navigation filter: inertial or ukf; repeat the option to fly both over "
            "the same terrain (default: kind of the scenario).",
        ),
        click.Option(
            ["--velocity-sigma"], type=click.FloatRange(min=1e-3), multiple=True, default=(),
            help="Initial velocity error, 1 sigma per axis (m/s); repeat the option for several "
            "values (default: value of the scenario).",
        ),
        click.Option(
            ["--without"], multiple=True, default=(),
            help="Name of a sensor to remove from the scenario; repeat the option for several "
            "sensors.",
        ),
        click.Option(
            ["--set", "changes"], multiple=True, default=(), metavar="KEY=VALUE",
            help="Set a scenario key, for example rocks.cover=0.1. Repeat the option for several "
            "keys.",
        ),
        click.Option(
            ["--check", "lower_factor"], type=click.FloatRange(min=0, max=1, min_open=True),
            metavar="FACTOR",
            help="Exit with status 1 if errors and reported uncertainties disagree. FACTOR "
            "multiplies the lower bound of the normalised estimation error squared; below 1, it "
            "accepts conservative uncertainties.",
        ),
        click.Option(
            ["--policy"], default="safest", show_default=True,
            help="Policy that selects the landing site: a name from `lunarsim parts policy`.",
        ),
    ),
    report=print_consistency,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
