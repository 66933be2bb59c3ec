r"""Check navigation consistency (NEES, NIS) and the effect of initial errors.

The script flies a scenario whose navigation has an error state. At five fixed fractions of the
planned descent time it compares the errors of position, velocity and attitude with their covariance
(NEES), and the innovations of each kind of measurement with theirs (NIS): those of the last
measurement before each epoch, and those of all measurements since the previous epoch. The second
set is larger and therefore more sensitive, but not independent; the bounds assume independence.
With `--position-sigma` given twice or more, each flight is repeated with each initial position
error over the same terrain.

python scenarios/navigation/consistency.py --flights 50 --jobs 2
python scenarios/navigation/consistency.py --flights 50 --jobs 2 --position-sigma 0.01
--position-sigma 100 python scenarios/navigation/consistency.py --flights 50 --kind inertial --kind
ukf python scenarios/navigation/consistency.py --flights 50 --scenario scenarios/shadow_nominal.toml
python scenarios/navigation/consistency.py --flights 20 --without stars --velocity-sigma 1
--velocity-sigma 10 python scenarios/navigation/consistency.py --scenario scenarios/morpheus.toml \
    --set sensors.flash.range_sigma_m=0.1
python scenarios/navigation/consistency.py --scenario scenarios/camera_and_lidar.toml --flights 50 \
    --set navigation.terrain_slope_deg=0.5 --set initial_uncertainty.target_elevation_m=5 --check 1
    --seed 1201
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table
from scipy.stats import binomtest
from shared_options import seed_and_jobs

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.consistency import Consistency, normalised_squared_error
from lunarsim.evaluation.statistics import Proportion
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.unscented import UnscentedFilter
from lunarsim.scenario.changes import with_changes

SCENARIOS = Path(__file__).resolve().parents[1]
EPOCHS = (0.15, 0.35, 0.55, 0.75, 0.95)
PARTS = {"all nine": np.arange(9), "position": np.r_[0:3], "velocity": np.r_[3:6],
         "attitude": np.r_[6:9]}  # fmt: skip
LEVEL = 0.999
# Scenarios of the long check: lower limit of NEES as a fraction of its bound, and changed keys. In
# morpheus NEES is lower, because a map post that is used again counts less and scans are assumed to
# differ by more than they do on horizontal grass. The keys give the terrain knowledge of the
# mission, so that a horizontal plane is not modelled as relief.
HORIZONTAL_TERRAIN = (
    "navigation.terrain_slope_deg=0.5",
    "initial_uncertainty.target_elevation_m=5",
)
SETS = {
    "instruments": (1.0, ()),
    "camera_and_lidar": (1.0, HORIZONTAL_TERRAIN),
    "shadow_nominal": (1.0, HORIZONTAL_TERRAIN),
    "morpheus": (0.5, ()),
}
# Innovations may be smaller than their covariance, by kind: a rock appears at the same wrong
# position in successive images while the view changes little, and reused maps correlate scans and
# fits.
MIN_NIS_FACTOR = {"places": 0.4, "scans": 0.2, "map": 0.0}
# They may also be larger: rocks with a radius of one pixel scatter by more than the model.
MAX_NIS_FACTOR = {"places": 1.7}
# Maximum error in standard deviations of a flight that is not declared lost; maximum fraction of
# lost flights.
MAX_ERROR_SIGMA, MAX_LOST_FRACTION = 5.0, 0.02
# Last words of the names of monitored quantities that correct nothing and are therefore not
# measurements: number of rocks found again, direction of shadows, and the position of scans that
# fit the map.
CHECKS = ("expected", "shadows", "fits")


@dataclass(frozen=True)
class ConsistencyTask:
    """Settings of one simulated flight of the navigation consistency study.

    `scenario` is the path of the file. `position_sigma` (m) and `velocity_sigma` (m/s) replace the
    initial uncertainty, 1 sigma per axis, and `kind` the kind of navigation; None: that of the
    scenario. `changes` holds the texts "KEY=VALUE" of changed scenario keys.
    `flight` and `seed` (root seed) determine the random numbers; `policy` selects the landing
    sites.
    """

    scenario: str
    position_sigma: float | None
    flight: int
    seed: int
    policy: str
    kind: str | None
    velocity_sigma: float | None = None
    removed_sensors: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ConsistencyFlight:
    """Results of one simulated flight of the navigation consistency study.

    Attributes
    ----------
    error, covariance
        Errors of position (m), velocity (m/s) and attitude (rad), ENU, at the e epochs (e, 9), and
        their covariance (e, 9, 9).
    latest_nis, nis_between_epochs
        Sums of normalised squared innovations (NIS) before each epoch, by kind of measurement:
        only the last cycle with a measurement, or all cycles since the previous epoch.
    total_nis
        Sums of NIS over the complete flight, by kind of measurement.
    rejected, inflated
        Number of rejected measurements by kind; number of `covariance-inflated` events (suspect
        measurements).
    lost
        Whether navigation declared itself lost at the end, and at any time.
    start_error, map_error
        Position error at the start, and at touchdown, m.
    safe
        Whether the landing was safe.
    """

    error: np.ndarray
    covariance: np.ndarray
    latest_nis: list[dict[str, Consistency]]
    nis_between_epochs: list[dict[str, Consistency]]
    total_nis: dict[str, Consistency]
    rejected: dict[str, int]
    inflated: int
    lost: tuple[bool, bool]
    start_error: float
    map_error: float
    safe: bool


def fly(task: ConsistencyTask) -> ConsistencyFlight:
    """Simulate one flight and record navigation errors, covariances and innovations."""
    scenario = with_changes(Scenario.load(Path(task.scenario)), task.changes)
    if task.position_sigma is not None:
        scenario = scenario.changed(initial_uncertainty={"position_m": task.position_sigma})
    if task.velocity_sigma is not None:
        scenario = scenario.changed(initial_uncertainty={"velocity_m_s": task.velocity_sigma})
    if task.removed_sensors:
        scenario = scenario.changed(sensors=dict.fromkeys(task.removed_sensors))
    if task.kind is not None:
        scenario = scenario.changed(navigation={"kind": task.kind})
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), task.policy)
    navigation = simulation.computer.navigation
    if not isinstance(navigation, Navigator | UnscentedFilter):
        raise click.UsageError(f"{task.scenario}: navigation.kind must be 'inertial' or 'ukf'")
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
    return ConsistencyFlight(
        np.array(errors).reshape(-1, 9),
        np.array(covariances).reshape(-1, 9, 9),
        latest,
        [subtract_sums(a, b) for a, b in pairwise(({}, *before))],
        nis_sums(navigation),
        {k: w.rejected_count for k, w in navigation.monitors.items() if corrects_state(k)},
        names.count("covariance-inflated"),
        (simulation.computer.estimate.lost, "lost" in names),
        start,
        float(np.linalg.norm(simulation.navigation_error)),
        simulation.outcome.safe,
    )


def corrects_state(kind: str) -> bool:
    """Return whether a monitored quantity corrects the navigation state.

    `kind` is the name of the quantity. The filter only checks the other quantities.
    """
    return kind.rsplit(maxsplit=1)[-1] not in CHECKS


def nis_sums(navigation: Navigator | UnscentedFilter) -> dict[str, Consistency]:
    """Return the sums of normalised squared innovations (NIS) by kind of measurement."""
    return {
        kind: Consistency(w.nis_sum, w.dof)
        for kind, w in navigation.monitors.items() if corrects_state(kind)
    }  # fmt: skip


def subtract_sums(
    before: dict[str, Consistency], after: dict[str, Consistency]
) -> dict[str, Consistency]:
    """Return the innovation sums of a time interval, from those at its two ends."""
    none = Consistency()
    return {
        kind: Consistency(
            c.total - before.get(kind, none).total, c.degrees - before.get(kind, none).degrees
        )
        for kind, c in after.items()
    }


def error_of(simulation: Simulation) -> np.ndarray:
    """Return the navigation error: position (m), velocity (m/s), attitude (rad).

    The error (9,) is truth minus estimate in the site frame (ENU).
    """
    state = simulation.state
    found = simulation.computer.navigation.estimate_in_site(simulation.time, state.mass)
    turn = quat_multiply(state.attitude, quat_conjugate(found.attitude))
    return np.concatenate(
        (
            state.position - found.position,
            state.velocity - found.velocity,
            quat_to_rotation_vector(turn),
        )
    )


def nees_of(flights: list[ConsistencyFlight], epoch: int, components: np.ndarray) -> Consistency:
    """Return the NEES of selected state errors at an epoch, summed over the flights.

    NEES is the normalised estimation error squared. `epoch` is an index of `EPOCHS`; `components`
    holds the indices of the selected errors among position, velocity and attitude (9). Flights that
    ended before the epoch are omitted.
    """
    found = Consistency()
    for f in flights:
        if len(f.error) > epoch:
            own = f.covariance[epoch][np.ix_(components, components)]
            found = found.plus(
                normalised_squared_error(f.error[epoch, components], own), len(components)
            )
    return found


def nees_table(flights: list[ConsistencyFlight]) -> Table:
    """Return the table of NEES per degree of freedom by epoch and part of the state.

    NEES is the normalised estimation error squared.
    """
    table = Table(title=f"NEES / degrees of freedom [{100 * LEVEL:g} % bounds]; !: outside")
    table.add_column("fraction of the descent", justify="right")
    for part in PARTS:
        table.add_column(part, justify="right")
    for k, share in enumerate(EPOCHS):
        cells = []
        for keep in PARTS.values():
            found = nees_of(flights, k, keep)
            low, high = found.bounds(LEVEL)
            mark = "" if found.holds(LEVEL) else " !"
            cells.append(f"{found.ratio:.2f} [{low:.2f}, {high:.2f}]{mark}")
        table.add_row(f"{share:.2f}", *cells)
    return table


def nis_table(flights: list[ConsistencyFlight], attribute: str, title: str) -> Table:
    """Return the table of NIS per degree of freedom by kind of measurement and epoch.

    NIS is the normalised innovation squared. `attribute` of the flights holds its sums:
    "latest_nis" or "nis_between_epochs"; `title` describes them in the title of the table.
    """
    table = Table(title=f"NIS / degrees of freedom, {title}; !: outside {100 * LEVEL:g} % bounds")
    for heading in ("measurement", *(f"{share:.2f}" for share in EPOCHS), "bounds at last epoch",
                    "rejected"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "measurement" else "right")
    by_epoch = [[getattr(f, attribute)[k] for f in flights if len(f.nis_between_epochs) > k]
                for k in range(len(EPOCHS))]  # fmt: skip
    for kind in sorted({kind for at in by_epoch for one in at for kind in one}):
        cells, bounds = [], ""
        for at in by_epoch:
            found = [one[kind] for one in at if kind in one]
            total = Consistency(sum(c.total for c in found), sum(c.degrees for c in found))
            if total.degrees == 0:
                cells.append("")
                continue
            low, high = total.bounds(LEVEL)
            cells.append(f"{total.ratio:.2f}{'' if total.holds(LEVEL) else ' !'}")
            bounds = f"[{low:.2f}, {high:.2f}]"
        refused = sum(f.rejected.get(kind, 0) for f in flights)
        table.add_row(kind, *cells, bounds, f"{refused}")
    return table


def inconsistencies(flights: list[ConsistencyFlight], lower_factor: float) -> list[str]:
    """Return a text for each inconsistency between navigation errors and covariance.

    `lower_factor` multiplies the lower bound of NEES (normalised estimation error squared). With a
    value below 1, larger covariances are permitted.
    """
    out = []
    lost = sum(f.lost[0] for f in flights)
    if lost > MAX_LOST_FRACTION * len(flights):
        out.append(f"{lost} of {len(flights)} flights ended lost")
    for n, f in enumerate(flights):
        # A mean can hide one flight with a large undeclared error.
        off = np.abs(f.error) / np.sqrt(np.diagonal(f.covariance, axis1=1, axis2=2))
        if not (f.lost[0] or (off < MAX_ERROR_SIGMA).all()):
            out.append(f"flight {n}: undeclared error of {off.max():.1f} sigma")
    for k, share in enumerate(EPOCHS):
        for part, keep in PARTS.items():
            out += _bound_violation(
                f"NEES of {part} at {share}", nees_of(flights, k, keep), lower_factor, 1.0
            )
        latest = [f.latest_nis[k] for f in flights if len(f.latest_nis) > k]
        for kind in sorted({kind for at in latest for kind in at}):
            found = [at[kind] for at in latest if kind in at]
            total = Consistency(sum(c.total for c in found), sum(c.degrees for c in found))
            least, most = (
                next((share for end, share in of.items() if kind.endswith(end)), 1.0)
                for of in (MIN_NIS_FACTOR, MAX_NIS_FACTOR)
            )
            out += _bound_violation(f"NIS of {kind} at {share}", total, least, most)
    return out


def _bound_violation(
    name: str, measured: Consistency, lower_factor: float, upper_factor: float
) -> list[str]:
    """Return a text if a normalised squared error is outside its bounds, else no text.

    `name` describes the quantity and `measured` is its sum. `lower_factor` and `upper_factor`
    multiply its lower and upper bound.
    """
    low, high = measured.bounds(LEVEL)
    if lower_factor * low <= measured.ratio <= upper_factor * high:
        return []
    return [
        f"{name}: {measured.ratio:.3f} is outside "
        f"{lower_factor * low:.3f} to {upper_factor * high:.3f}"
    ]


def safe_table(flights_by_variant: dict[str, list[ConsistencyFlight]]) -> Table:
    """Return the table of landing results by variant of the study.

    A variant is an initial error with a kind of navigation. The others are compared with the first.
    """
    table = Table(title="Landings")
    for heading in ("initial error\n(1 sigma per axis, m), kind", "initial error,\nmedian (m)",
                    "touchdown error,\nmedian (m)", "safe landings",
                    "against the first:\nbetter, worse (p)",
                    "suspect\nmeasurements", "lost at the\nend, ever"):  # fmt: skip
        table.add_column(heading, justify="right")
    first = [f.safe for f in next(iter(flights_by_variant.values()))]
    for n, (start, flights) in enumerate(flights_by_variant.items()):
        mine = [f.safe for f in flights]
        landed = Proportion(sum(mine), len(mine))
        low, high = landed.interval
        won = sum(a and not b for a, b in zip(mine, first, strict=True))
        lost = sum(b and not a for a, b in zip(mine, first, strict=True))
        p = binomtest(won, won + lost).pvalue if won + lost else 1.0
        table.add_row(
            start, f"{np.median([f.start_error for f in flights]):.1f}",
            f"{np.median([f.map_error for f in flights]):.1f}",
            f"{sum(mine)} of {len(mine)} [{low:.2f}, {high:.2f}]",
            "" if n == 0 else f"{won}, {lost} ({p:.2f})",
            f"{sum(f.inflated for f in flights)}",
            f"{sum(f.lost[0] for f in flights)}, {sum(f.lost[1] for f in flights)}",
        )  # fmt: skip
    return table


def flight_to_json(flight: ConsistencyFlight) -> dict[str, Any]:
    """Return a flight's results for JSON, with NEES and NIS per degree of freedom.

    NEES and NIS are the normalised squares of estimation errors and of innovations.
    """
    nees = {}
    for part, keep in PARTS.items():
        squares = [
            normalised_squared_error(error[keep], covariance[np.ix_(keep, keep)])
            for error, covariance in zip(flight.error, flight.covariance, strict=True)
        ]
        nees[part] = sum(squares) / (len(keep) * len(squares)) if squares else None
    nis, last = (
        [{kind: [c.total, c.degrees] for kind, c in at.items() if c.degrees} for at in epochs]
        for epochs in (flight.nis_between_epochs, flight.latest_nis)
    )
    sums = {kind: c.ratio for kind, c in flight.total_nis.items() if c.degrees}
    return {
        "nees": nees, "nis": sums, "nis_at": nis, "nis_last": last, "error": flight.error.tolist(),
        "sigma": [np.sqrt(np.diag(c)).tolist() for c in flight.covariance],
        "start_error": flight.start_error, "map_error": flight.map_error,
        "lost": flight.lost[0], "safe": bool(flight.safe),
    }  # fmt: skip


@click.command()
@click.option(
    "--scenario",
    type=click.Path(exists=True, dir_okay=False),
    default=str(SCENARIOS / "instruments.toml"),
    show_default="instruments.toml",
    help="Scenario to fly (TOML file).",
)
@click.option(
    "--flights",
    type=click.IntRange(min=2),
    default=10,
    show_default=True,
    help="Number of flights for each combination of initial error and kind of navigation.",
)
@click.option(
    "--position-sigma",
    "position_sigmas",
    type=click.FloatRange(min=1e-3),
    multiple=True,
    help="Initial position error, 1 sigma per axis (m); repeat the option for several values "
    "(default: value of the scenario).",
)
@click.option(
    "--kind",
    "kinds",
    type=click.Choice(("inertial", "ukf")),
    multiple=True,
    help="Kind of navigation filter: inertial or ukf; repeat the option to fly both over the same "
    "terrain (default: kind of the scenario).",
)
@click.option(
    "--velocity-sigma",
    "velocity_sigmas",
    type=click.FloatRange(min=1e-3),
    multiple=True,
    help="Initial velocity error, 1 sigma per axis (m/s); repeat the option for several values "
    "(default: value of the scenario).",
)
@click.option(
    "--without",
    multiple=True,
    help="Name of a sensor to remove from the scenario; repeat the option for several sensors.",
)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set a scenario key, for example rocks.cover=0.1. Repeat the option for several keys.",
)
@click.option("--check", "lower_factor", type=click.FloatRange(min=0, max=1, min_open=True),
metavar="FACTOR",
              help="Exit with status 1 if errors and reported uncertainties disagree. FACTOR "
              "multiplies the lower bound of the normalised estimation error squared; below 1, it "
              "accepts conservative uncertainties.")  # fmt: skip
@click.option(
    "--policy",
    default="safest",
    show_default=True,
    help="Policy that selects the landing site: a name from `lunarsim parts policy`.",
)
@click.option(
    "--json",
    "out",
    type=click.Path(path_type=Path),
    help="JSON file for the results of all flights, by initial error. Default: none.",
)
@seed_and_jobs
def main(
    scenario: str, flights: int, position_sigmas: tuple[float, ...], kinds: tuple[str, ...],
    velocity_sigmas: tuple[float, ...], without: tuple[str, ...], changes: tuple[str, ...],
    policy: str, lower_factor: float | None, out: Path | None, seed: int, jobs: int,
) -> None:  # fmt: skip
    """Fly a scenario and compare the reported navigation errors with the true ones."""
    console = plain_console(120)
    by_start: dict[str, list[ConsistencyFlight]] = {}
    for kind, start, speed in product(
        kinds or (None,), position_sigmas or (None,), velocity_sigmas or (None,)
    ):
        tasks = [
            ConsistencyTask(scenario, start, n, seed, policy, kind, speed, without, changes)
            for n in range(flights)
        ]
        name = "the scenario's" if start is None else f"{start:g}"
        name += "" if speed is None else f", {speed:g} m/s"
        name += "" if kind is None else f", {kind}"
        by_start[name] = collect_results(fly, tasks, jobs, console, f"flights from {name}")
    for name, flown in by_start.items():
        console.print(f"Initial error: {name}")
        console.print(nees_table(flown))
        console.print(nis_table(flown, "latest_nis", "of the last measurement before each epoch"))
        console.print(
            nis_table(flown, "nis_between_epochs", "of all measurements since the previous epoch")
        )
    console.print(safe_table(by_start))
    if out is not None:
        written = {name: [flight_to_json(f) for f in flown] for name, flown in by_start.items()}
        out.write_text(json.dumps(written, indent=1))
    if lower_factor is not None:
        wrong = [
            f"{name}: {w}"
            for name, flown in by_start.items()
            for w in inconsistencies(flown, lower_factor)
        ]
        for line in wrong:
            console.print(line)
        if wrong:
            raise click.exceptions.Exit(1)


if __name__ == "__main__":
    main()
