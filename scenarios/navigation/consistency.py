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

    `scenario` is the path of the file. `start` (m) and `speed` (m/s) replace the initial position
    and velocity uncertainty, 1 sigma per axis, and `kind` the kind of navigation; None: that of the
    scenario. `without` lists removed sensors, `changes` the texts "KEY=VALUE" of changed keys.
    `flight` and `seed` (root seed) determine the random numbers; `policy` selects the landing
    sites.
    """

    scenario: str
    start: float | None
    flight: int
    seed: int
    policy: str
    kind: str | None
    speed: float | None = None
    without: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ConsistencyFlight:
    """Results of one simulated flight of the navigation consistency study.

    Attributes
    ----------
    error, covariance
        Errors of position (m), velocity (m/s) and attitude (rad), ENU, at the e epochs (e, 9), and
        their covariance (e, 9, 9).
    latest, innovations
        Sums of normalised squared innovations (NIS) before each epoch, by kind of measurement: of
        the last cycle with a measurement, and of all cycles since the previous epoch.
    totals
        The same sums for the complete flight.
    refused, inflated
        Number of rejected measurements by kind; number of `covariance-inflated` events (suspect
        measurements).
    lost
        Whether navigation declared itself lost at the end, and whether it ever did.
    start_error, map_error
        Position error at the start, and at touchdown, m.
    safe
        Whether the landing was safe.
    """

    error: np.ndarray
    covariance: np.ndarray
    latest: list[dict[str, Consistency]]
    innovations: list[dict[str, Consistency]]
    totals: dict[str, Consistency]
    refused: dict[str, int]
    inflated: int
    lost: tuple[bool, bool]
    start_error: float
    map_error: float
    safe: bool


def fly(task: ConsistencyTask) -> ConsistencyFlight:
    """Simulate one flight and record navigation errors, covariances and innovations."""
    scenario = with_changes(Scenario.load(Path(task.scenario)), task.changes)
    if task.start is not None:
        scenario = scenario.changed(initial_uncertainty={"position_m": task.start})
    if task.speed is not None:
        scenario = scenario.changed(initial_uncertainty={"velocity_m_s": task.speed})
    if task.without:
        scenario = scenario.changed(sensors=dict.fromkeys(task.without))
    if task.kind is not None:
        scenario = scenario.changed(navigation={"kind": task.kind})
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), task.policy)
    navigation = simulation.computer.navigation
    if not isinstance(navigation, Navigator | UnscentedFilter):
        raise click.UsageError(
            f"{task.scenario}: navigation must have an error state (inertial or ukf)"
        )
    planned = simulation.computer.time_to_go
    due = [share * planned for share in EPOCHS]
    errors, covariances, before, latest = [], [], [], []
    last: dict[str, Consistency] = {}
    start = float(np.linalg.norm(error_of(simulation)[:3]))
    while not simulation.done:
        already = totals(navigation)
        simulation.step()
        new = difference(already, totals(navigation))
        last |= {kind: c for kind, c in new.items() if c.degrees}
        if due and not simulation.done and simulation.time >= due[0] - 1e-9:
            due.pop(0)
            errors.append(error_of(simulation))
            covariances.append(simulation.estimate.covariance)
            before.append(totals(navigation))
            latest.append(last)
            last = {}
    names = [name for _, name, _ in simulation.computer.telemetry]
    return ConsistencyFlight(
        np.array(errors).reshape(-1, 9),
        np.array(covariances).reshape(-1, 9, 9),
        latest,
        [difference(a, b) for a, b in pairwise(({}, *before))],
        totals(navigation),
        {k: w.rejected_count for k, w in navigation.monitors.items() if corrects(k)},
        names.count("covariance-inflated"),
        (simulation.computer.estimate.lost, "lost" in names),
        start,
        float(np.linalg.norm(simulation.navigation_error)),
        simulation.outcome.safe,
    )


def corrects(kind: str) -> bool:
    """Return whether a monitored quantity corrects the navigation state.

    `kind` is its name; some monitored quantities are only checked.
    """
    return kind.rsplit(maxsplit=1)[-1] not in CHECKS


def totals(navigation: Navigator | UnscentedFilter) -> dict[str, Consistency]:
    """Return the sums of normalised squared innovations by kind of measurement."""
    return {
        kind: Consistency(w.nis_sum, w.dof)
        for kind, w in navigation.monitors.items() if corrects(kind)
    }  # fmt: skip


def difference(
    before: dict[str, Consistency], now: dict[str, Consistency]
) -> dict[str, Consistency]:
    """Subtract two sets of innovation sums: those at time `now` minus those `before`."""
    none = Consistency()
    return {
        kind: Consistency(
            c.total - before.get(kind, none).total, c.degrees - before.get(kind, none).degrees
        )
        for kind, c in now.items()
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


def nees_of(flights: list[ConsistencyFlight], epoch: int, keep: np.ndarray) -> Consistency:
    """Return the NEES of selected state errors at an epoch, summed over the flights.

    NEES is the normalised estimation error squared. `epoch` is an index of `EPOCHS`; `keep` holds
    the indices of the selected errors among the nine. Flights that ended before the epoch are
    omitted.
    """
    found = Consistency()
    for f in flights:
        if len(f.error) > epoch:
            own = f.covariance[epoch][np.ix_(keep, keep)]
            found = found.plus(normalised_squared_error(f.error[epoch, keep], own), len(keep))
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


def nis_table(flights: list[ConsistencyFlight], which: str, title: str) -> Table:
    """Return the table of NIS per degree of freedom by kind of measurement and epoch.

    NIS is the normalised innovation squared.

    Parameters
    ----------
    which
        Attribute of `ConsistencyFlight` that holds the innovation sums: "latest" or "innovations".
    title
        Description of these innovations for the title of the table.
    """
    table = Table(title=f"NIS / degrees of freedom, {title}; !: outside {100 * LEVEL:g} % bounds")
    for heading in ("measurement", *(f"{share:.2f}" for share in EPOCHS), "bounds at last epoch",
                    "rejected"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "measurement" else "right")
    by_epoch = [[getattr(f, which)[k] for f in flights if len(f.innovations) > k]
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
        refused = sum(f.refused.get(kind, 0) for f in flights)
        table.add_row(kind, *cells, bounds, f"{refused}")
    return table


def inconsistencies(flights: list[ConsistencyFlight], modest: float) -> list[str]:
    """Return a text for each inconsistency between navigation errors and covariance.

    Parameters
    ----------
    flights
        Flights of one variant.
    modest
        Factor on the lower bound of NEES (normalised estimation error squared); below 1, larger
        covariances are permitted.
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
            out += _outside(f"NEES of {part} at {share}", nees_of(flights, k, keep), modest, 1.0)
        latest = [f.latest[k] for f in flights if len(f.latest) > k]
        for kind in sorted({kind for at in latest for kind in at}):
            found = [at[kind] for at in latest if kind in at]
            total = Consistency(sum(c.total for c in found), sum(c.degrees for c in found))
            least, most = (
                next((share for end, share in of.items() if kind.endswith(end)), 1.0)
                for of in (MIN_NIS_FACTOR, MAX_NIS_FACTOR)
            )
            out += _outside(f"NIS of {kind} at {share}", total, least, most)
    return out


def _outside(name: str, found: Consistency, modest: float, bold: float) -> list[str]:
    """Return a text if a normalised error is outside its bounds, else an empty list.

    `name` describes the quantity and `found` is its sum. `modest` and `bold` are factors on the
    lower and the upper bound.
    """
    low, high = found.bounds(LEVEL)
    if modest * low <= found.ratio <= bold * high:
        return []
    return [f"{name}: {found.ratio:.3f} is outside {modest * low:.3f} to {bold * high:.3f}"]


def safe_table(by_start: dict[str, list[ConsistencyFlight]]) -> Table:
    """Return the table of landing results by initial navigation error.

    `by_start` holds the flights of each variant (initial error and kind of navigation) by its name;
    the first variant is the reference of the others.
    """
    table = Table(title="Landings")
    for heading in ("initial error\n(1 sigma per axis, m), kind", "initial error,\nmedian (m)",
                    "touchdown error,\nmedian (m)", "safe landings",
                    "against the first:\nbetter, worse (p)",
                    "measurements\ndoubted", "lost at the\nend, ever"):  # fmt: skip
        table.add_column(heading, justify="right")
    first = [f.safe for f in next(iter(by_start.values()))]
    for n, (start, flights) in enumerate(by_start.items()):
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
        for epochs in (flight.innovations, flight.latest)
    )
    sums = {kind: c.ratio for kind, c in flight.totals.items() if c.degrees}
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
    help="Scenario file.",
)
@click.option(
    "--flights",
    type=click.IntRange(min=2),
    default=10,
    show_default=True,
    help="Number of flights per variant (initial error and kind of navigation).",
)
@click.option(
    "--position-sigma",
    "starts",
    type=click.FloatRange(min=1e-3),
    multiple=True,
    help="Initial position error, 1 sigma per axis (m); repeatable (default: as in the scenario).",
)
@click.option(
    "--kind",
    "kinds",
    type=click.Choice(("inertial", "ukf")),
    multiple=True,
    help="Kind of navigation; repeatable, over the same terrain (default: that of the scenario).",
)
@click.option(
    "--velocity-sigma",
    "speeds",
    type=click.FloatRange(min=1e-3),
    multiple=True,
    help="Initial velocity error, 1 sigma per axis (m/s); repeatable (default: of the scenario).",
)
@click.option("--without", multiple=True, help="Sensor to remove; repeatable.")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set a scenario key; repeatable.",
)
@click.option("--check", "judge", type=click.FloatRange(min=0, max=1, min_open=True),
metavar="MODEST",
              help="Exit with status 1 if inconsistent; MODEST is a factor on "
                   "the lower NEES bound.")  # fmt: skip
@click.option("--policy", default="safest", show_default=True, help="Retargeting policy.")
@click.option(
    "--json",
    "out",
    type=click.Path(path_type=Path),
    help="Output file of all flights, by initial error.",
)
@seed_and_jobs
def main(
    scenario: str, flights: int, starts: tuple[float, ...], kinds: tuple[str, ...],
    speeds: tuple[float, ...], without: tuple[str, ...], changes: tuple[str, ...], policy: str,
    judge: float | None, out: Path | None, seed: int, jobs: int,
) -> None:  # fmt: skip
    """Fly a scenario and compare the reported navigation errors with the true ones."""
    console = plain_console(120)
    by_start: dict[str, list[ConsistencyFlight]] = {}
    for kind, start, speed in product(kinds or (None,), starts or (None,), speeds or (None,)):
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
        console.print(nis_table(flown, "latest", "of the last measurement before each epoch"))
        console.print(
            nis_table(flown, "innovations", "of all measurements since the previous epoch")
        )
    console.print(safe_table(by_start))
    if out is not None:
        written = {name: [flight_to_json(f) for f in flown] for name, flown in by_start.items()}
        out.write_text(json.dumps(written, indent=1))
    if judge is not None:
        wrong = [
            f"{name}: {w}"
            for name, flown in by_start.items()
            for w in inconsistencies(flown, judge)
        ]
        for line in wrong:
            console.print(line)
        if wrong:
            raise click.exceptions.Exit(1)


if __name__ == "__main__":
    main()
