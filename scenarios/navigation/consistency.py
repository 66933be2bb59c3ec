"""Whether navigation errs by what it says, in flights, and what an error at the start does.

Flies a scenario whose navigation has an error state. At five fixed shares of the planned descent
the errors of position, velocity and attitude are set against their covariance (NEES), and the
innovations of every kind of measurement against theirs (NIS): of the last ones before each of these
epochs, and of all since the epoch before. The second are many and so tell finer, but are not
independent: bounds are for those that are. With `--start` given twice or more each flight is flown
from each error of position at the start, over the same ground.

python scenarios/navigation/consistency.py --flights 50 --jobs 2
python scenarios/navigation/consistency.py --flights 50 --jobs 2 --start 0.01 --start 100
python scenarios/navigation/consistency.py --flights 50 --kind inertial --kind ukf
python scenarios/navigation/consistency.py --flights 50 --scenario scenarios/shadow_nominal.toml
python scenarios/navigation/consistency.py --flights 20 --without stars --speed 1 --speed 10
python scenarios/navigation/consistency.py --scenario scenarios/morpheus.toml \
    --set sensors.flash.range_sigma_m=0.1
python scenarios/navigation/consistency.py --scenario scenarios/two_eyes.toml --flights 50 \
    --set navigation.relief_deg=0.5 --set start_knowledge.ground_m=5 --judge 1 --seed 1201
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
from study import seed_and_jobs

from lunarsim.campaign.pool import gathered
from lunarsim.console import plain_console
from lunarsim.evaluation.consistency import Consistency, normalised_square
from lunarsim.evaluation.statistics import Proportion
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.unscented import UnscentedFilter
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_changes
from lunarsim.simulation import Simulation

SCENARIOS = Path(__file__).resolve().parents[1]
EPOCHS = (0.15, 0.35, 0.55, 0.75, 0.95)
PARTS = {"all nine": np.arange(9), "position": np.r_[0:3], "velocity": np.r_[3:6],
         "attitude": np.r_[6:9]}  # fmt: skip
LEVEL = 0.999
# Sets of sensors that are judged at length: how modest each may be, since what a map's post tells
# counts less where it is used again and scans are taken to differ by more than they do on level
# grass; and what the mission knows of the ground, so that a level plane is not told to be relief.
PLANE = ("navigation.relief_deg=0.5", "start_knowledge.ground_m=5")
SETS = {
    "instruments": (1.0, ()),
    "two_eyes": (1.0, PLANE),
    "shadow_nominal": (1.0, PLANE),
    "morpheus": (0.5, ()),
}
# Innovations may be smaller than said, by kind: a rock shows in the same wrong place from look to
# look while the view hardly turns, and what a map that is used again makes of scans and of fits.
MODEST = {"places": 0.4, "scans": 0.2, "map": 0.0}
# And larger: rocks of a pixel a radius scatter by more than is said.
BOLD = {"places": 1.7}
# No error is so many of its deviations unless navigation is lost; so many flights may be, of 50.
FAR, LOST = 5.0, 0.02
# What is watched and corrects nothing is no measurement, by the last word of its kind: how many
# rocks were found again and whether shadows fall where the Sun throws them, both against a
# tolerance, and whether scans that fit the map fit it where they are taken to lie.
CHECKS = ("expected", "shadows", "fits")


@dataclass(frozen=True)
class Task:
    """One flight."""

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
class Flown:
    """What came of it.

    Attributes
    ----------
    error, covariance
        At the epochs (e, 9), (e, 9, 9).
    latest, innovations
        Before each epoch by kind of measurement, normalised squares added up: of the last cycle
        that measured it, and of all cycles from the epoch before on.
    whole
        The same of the whole flight.
    refused, doubted
        Measurements that were, by kind; how often a kind was doubted.
    lost
        Whether navigation said so at the end, and whether it ever did.
    start_error, map_error
        Error of position at the start, and at touchdown, m.
    safe
        Whether the lander came down safely.
    """

    error: np.ndarray
    covariance: np.ndarray
    latest: list[dict[str, Consistency]]
    innovations: list[dict[str, Consistency]]
    whole: dict[str, Consistency]
    refused: dict[str, int]
    doubted: int
    lost: tuple[bool, bool]
    start_error: float
    map_error: float
    safe: bool


def fly(task: Task) -> Flown:
    """Fly once, and compare what navigation says with the truth."""
    scenario = with_changes(Scenario.load(Path(task.scenario)), task.changes)
    if task.start is not None:
        scenario = scenario.changed(start_knowledge={"position_m": task.start})
    if task.speed is not None:
        scenario = scenario.changed(start_knowledge={"velocity_m_s": task.speed})
    if task.without:
        scenario = scenario.changed(sensors=dict.fromkeys(task.without))
    if task.kind is not None:
        scenario = scenario.changed(navigation={"kind": task.kind})
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), task.policy)
    navigation = simulation.computer.navigation
    if not isinstance(navigation, Navigator | UnscentedFilter):
        raise click.UsageError(f"{task.scenario}: its navigation has no error state to be judged")
    planned = simulation.computer.time_to_go
    due = [share * planned for share in EPOCHS]
    errors, covariances, before, latest = [], [], [], []
    last: dict[str, Consistency] = {}
    start = float(np.linalg.norm(error_of(simulation)[:3]))
    while not simulation.done:
        already = totals(navigation)
        simulation.step()
        new = since(already, totals(navigation))
        last |= {kind: c for kind, c in new.items() if c.degrees}
        if due and not simulation.done and simulation.time >= due[0] - 1e-9:
            due.pop(0)
            errors.append(error_of(simulation))
            covariances.append(simulation.estimate.covariance)
            before.append(totals(navigation))
            latest.append(last)
            last = {}
    names = [name for _, name, _ in simulation.computer.telemetry]
    return Flown(
        np.array(errors).reshape(-1, 9),
        np.array(covariances).reshape(-1, 9, 9),
        latest,
        [since(a, b) for a, b in pairwise(({}, *before))],
        totals(navigation),
        {k: w.refused for k, w in navigation.watches.items() if corrects(k)},
        names.count("doubted"),
        (simulation.computer.estimate.lost, "lost" in names),
        start,
        float(np.linalg.norm(simulation.navigation_error)),
        simulation.verdict.safe,
    )


def corrects(kind: str) -> bool:
    """Return whether what is watched under a name corrects the state."""
    return kind.rsplit(maxsplit=1)[-1] not in CHECKS


def totals(navigation: Navigator | UnscentedFilter) -> dict[str, Consistency]:
    """Return the normalised squares of all innovations so far, by kind of measurement."""
    return {
        kind: Consistency(w.total, w.degrees)
        for kind, w in navigation.watches.items() if corrects(kind)
    }  # fmt: skip


def since(before: dict[str, Consistency], now: dict[str, Consistency]) -> dict[str, Consistency]:
    """Return what has been added to the totals."""
    none = Consistency()
    return {
        kind: Consistency(
            c.total - before.get(kind, none).total, c.degrees - before.get(kind, none).degrees
        )
        for kind, c in now.items()
    }


def error_of(simulation: Simulation) -> np.ndarray:
    """Return the errors of position, velocity and attitude (ENU) in the site frame (9,)."""
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


def nees_of(flights: list[Flown], epoch: int, keep: np.ndarray) -> Consistency:
    """Return the NEES of some of the nine errors at an epoch, over the flights that came so far."""
    found = Consistency()
    for f in flights:
        if len(f.error) > epoch:
            own = f.covariance[epoch][np.ix_(keep, keep)]
            found = found.plus(normalised_square(f.error[epoch, keep], own), len(keep))
    return found


def nees_table(flights: list[Flown]) -> Table:
    """Return NEES over its degrees of freedom, by epoch and part."""
    table = Table(title=f"NEES over degrees of freedom, {100 * LEVEL:g} % bounds in brackets")
    table.add_column("share of the descent", justify="right")
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


def nis_table(flights: list[Flown], which: str, title: str) -> Table:
    """Return NIS over its degrees of freedom, by kind of measurement and epoch.

    Parameters
    ----------
    which
        Attribute of `Flown`: "latest" or "innovations".
    """
    table = Table(
        title=f"NIS over degrees of freedom, {title}; !: not within {100 * LEVEL:g} % bounds"
    )
    for heading in ("measurement", *(f"{share:.2f}" for share in EPOCHS), "bounds at the last",
                    "refused"):  # fmt: skip
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


def broken(flights: list[Flown], modest: float) -> list[str]:
    """Return where errors are not what is said, a line each.

    Parameters
    ----------
    modest
        Share of its lower bound by which NEES may be less.
    """
    out = []
    lost = sum(f.lost[0] for f in flights)
    if lost > LOST * len(flights):
        out.append(f"{lost} of {len(flights)} flights are lost")
    for n, f in enumerate(flights):
        # A mean hides one that is far off and does not know.
        off = np.abs(f.error) / np.sqrt(np.diagonal(f.covariance, axis1=1, axis2=2))
        if not (f.lost[0] or (off < FAR).all()):
            out.append(f"flight {n} is {off.max():.1f} sigma off, undeclared")
    for k, share in enumerate(EPOCHS):
        for part, keep in PARTS.items():
            out += _outside(f"NEES of {part} at {share}", nees_of(flights, k, keep), modest, 1.0)
        latest = [f.latest[k] for f in flights if len(f.latest) > k]
        for kind in sorted({kind for at in latest for kind in at}):
            found = [at[kind] for at in latest if kind in at]
            total = Consistency(sum(c.total for c in found), sum(c.degrees for c in found))
            least, most = (
                next((share for end, share in of.items() if kind.endswith(end)), 1.0)
                for of in (MODEST, BOLD)
            )
            out += _outside(f"NIS of {kind} at {share}", total, least, most)
    return out


def _outside(name: str, found: Consistency, modest: float, bold: float) -> list[str]:
    low, high = found.bounds(LEVEL)
    if modest * low <= found.ratio <= bold * high:
        return []
    return [f"{name}: {found.ratio:.3f}, not from {modest * low:.3f} to {bold * high:.3f}"]


def safe_table(by_start: dict[str, list[Flown]]) -> Table:
    """Return how flights ended, by error at the start."""
    table = Table(title="Landings")
    for heading in ("error at the start\n(1 sigma an axis, m), kind", "drawn, median (m)",
                    "at touchdown,\nmedian (m)", "landed safe", "against the first:\nwon, lost (p)",
                    "doubted", "lost at the end,\never"):  # fmt: skip
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
            f"{sum(f.doubted for f in flights)}",
            f"{sum(f.lost[0] for f in flights)}, {sum(f.lost[1] for f in flights)}",
        )  # fmt: skip
    return table


def plain(flight: Flown) -> dict[str, Any]:
    """Return a flight as JSON has it: NEES, and NIS of all of it, over degrees of freedom."""
    nees = {}
    for part, keep in PARTS.items():
        squares = [
            normalised_square(error[keep], covariance[np.ix_(keep, keep)])
            for error, covariance in zip(flight.error, flight.covariance, strict=True)
        ]
        nees[part] = sum(squares) / (len(keep) * len(squares)) if squares else None
    nis, last = (
        [{kind: [c.total, c.degrees] for kind, c in at.items() if c.degrees} for at in epochs]
        for epochs in (flight.innovations, flight.latest)
    )
    whole = {kind: c.ratio for kind, c in flight.whole.items() if c.degrees}
    return {
        "nees": nees, "nis": whole, "nis_at": nis, "nis_last": last, "error": flight.error.tolist(),
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
    help="Scenario whose navigation is judged.",
)
@click.option(
    "--flights",
    type=click.IntRange(min=2),
    default=10,
    show_default=True,
    help="From each error at the start.",
)
@click.option(
    "--start",
    "starts",
    type=click.FloatRange(min=1e-3),
    multiple=True,
    help="Error of position at the start, 1 sigma an axis, m; may be given again. "
    "Left out: the scenario's.",
)
@click.option(
    "--kind",
    "kinds",
    type=click.Choice(("inertial", "ukf")),
    multiple=True,
    help="Navigation; may be given again, to be flown over the same ground. Left out: the "
    "scenario's.",
)
@click.option(
    "--speed",
    "speeds",
    type=click.FloatRange(min=1e-3),
    multiple=True,
    help="Error of velocity at the start, 1 sigma an axis, m/s; may be given again. Left out: the "
    "scenario's.",
)
@click.option(
    "--without", multiple=True, help="Sensor that the lander does not carry; may be given again."
)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="Another value of a key of the scenario; may be repeated.",
)
@click.option("--judge", type=click.FloatRange(min=0, max=1, min_open=True), metavar="MODEST",
              help="End with 1 where errors are not what is said; NEES may be less than its lower "
                   "bound by this share.")  # fmt: skip
@click.option("--policy", default="safest", show_default=True, help="Retargeting policy.")
@click.option("--json", "out", type=click.Path(path_type=Path), help="Every flight, by its start.")
@seed_and_jobs
def main(
    scenario: str, flights: int, starts: tuple[float, ...], kinds: tuple[str, ...],
    speeds: tuple[float, ...], without: tuple[str, ...], changes: tuple[str, ...], policy: str,
    judge: float | None, out: Path | None, seed: int, jobs: int,
) -> None:  # fmt: skip
    """Fly, and compare what navigation says of its errors with the errors."""
    console = plain_console(120)
    by_start: dict[str, list[Flown]] = {}
    for kind, start, speed in product(kinds or (None,), starts or (None,), speeds or (None,)):
        tasks = [
            Task(scenario, start, n, seed, policy, kind, speed, without, changes)
            for n in range(flights)
        ]
        name = "the scenario's" if start is None else f"{start:g}"
        name += "" if speed is None else f", {speed:g} m/s"
        name += "" if kind is None else f", {kind}"
        by_start[name] = gathered(fly, tasks, jobs, console, f"flights from {name}")
    for name, flown in by_start.items():
        console.print(f"Error at the start: {name}")
        console.print(nees_table(flown))
        console.print(nis_table(flown, "latest", "of the last measurement before each epoch"))
        console.print(nis_table(flown, "innovations", "of all since the epoch before"))
    console.print(safe_table(by_start))
    if out is not None:
        written = {name: [plain(f) for f in flown] for name, flown in by_start.items()}
        out.write_text(json.dumps(written, indent=1))
    if judge is not None:
        wrong = [f"{name}: {w}" for name, flown in by_start.items() for w in broken(flown, judge)]
        for line in wrong:
            console.print(line)
        if wrong:
            raise click.exceptions.Exit(1)


if __name__ == "__main__":
    main()
