"""What each guidance law spends over the least that could be spent: paired closed-loop flights.

Every law flies the same starts, scattered about the planned one, to the same site, without diverts.
The optimum is that of the true start of each flight, by `lunarsim.optimal` under the same throttle
margin, tilt, glideslope and reserve, for a point mass without lags; spent is what the tanks lost up
to the end of the approach. A law that ends the approach elsewhere than asked or at another speed
may spend less than the optimum of the way asked for: how far off it ends is told besides, and what
is spent down to the ground over the optimum with the steady vertical descent after it.

python scenarios/guidance/propellant.py --flights 300 --jobs 2 --json propellant.json
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table

from lunarsim.campaign.pool import gathered
from lunarsim.console import plain_console
from lunarsim.errors import InputError, check_output
from lunarsim.evaluation.statistics import Proportion
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.computer import APPROACH
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import least_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent
from lunarsim.parts.registry import kinds
from lunarsim.rng import Streams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation, build_world
from lunarsim.world import World

# A lander that only flies: no maps, little ground. Fixes know the height of the site better than by
# themselves, since there is no map that would level it.
FLOWN: dict[str, Any] = {
    "name": "propellant",
    "terrain": {"kind": "fractal", "size_m": 200.0, "rms_slope_deg": 1.0},
    "rocks": {"cover": 0.01},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "navigation": {"kind": "fixes"},
    "mappers": {},
    "tasking": {},
}
SEEKING = "information-seeking"
# What the law that chooses its path by what it sees flies with besides: a LiDAR, and a map of its
# returns. No other law looks; none retargets.
EYES: dict[str, Any] = {
    "sensors": {**FLOWN["sensors"], "flash": {"kind": "flash-lidar"}},
    "mappers": {
        "dem": {"kind": "gaussian-dem", "sensor": "flash", "size_m": 60.0, "posting_m": 0.25}
    },
    "tasking": {"flash": {"kind": "at-altitudes", "altitudes_m": [300.0, 200.0, 130.0, 80.0]}},
}
_DROP = 0.5  # of the glideslope's tip under the end, m: what all laws are given


@dataclass(frozen=True)
class Task:
    """One flight under every law."""

    laws: tuple[str, ...]
    flight: int
    seed: int
    position_sigma: float
    velocity_sigma: float


@dataclass(frozen=True)
class Flown:
    """What came of one law.

    Attributes
    ----------
    law, flight
        Which.
    optimum, descent
        Least propellant to the end of the approach from the true start, and of a steady vertical
        descent after it, kg.
    approach, whole
        Spent to the end of the approach, and to the ground, kg.
    miss, speed
        How far from the place (as navigation has both) and from the velocity asked for the approach
        ended, m and m/s.
    safe, failed
        Whether it came down safely, and why not.
    fallbacks, plans
        Of the optimal law.
    asked, infeasible
        Of a network: how often it was asked, and how often its answer broke the law's limits.
    """

    law: str
    flight: int
    optimum: float
    descent: float
    approach: float
    whole: float
    miss: float
    speed: float
    safe: bool
    failed: str
    fallbacks: int
    plans: int
    asked: int
    infeasible: int

    @property
    def over(self) -> float:
        """Share spent over the optimum up to the end of the approach."""
        return self.approach / self.optimum - 1.0

    @property
    def all_over(self) -> float:
        """Share spent over the optimum and the descent after it, down to the ground."""
        return self.whole / (self.optimum + self.descent) - 1.0


def scenario_of(law: str, position_sigma: float, velocity_sigma: float) -> Scenario:
    """Return the scenario of a law."""
    start = {"position_sigma_m": position_sigma, "velocity_sigma_m_s": velocity_sigma}
    eyes = EYES if law == SEEKING else {}
    return Scenario.from_dict({**FLOWN, **eyes, "start": start, "guidance": {"kind": law}})


@cache
def ground() -> World:
    """Return the ground of all flights: the law that looks sees it, to others it is a touchdown."""
    return build_world(scenario_of("apollo", 0.0, 0.0), Streams(1))


def problem(flight: Simulation) -> Descent:
    """Return the descent of a flight's true start to the end of its approach."""
    briefing = flight.briefing
    lander, approach = briefing.lander, briefing.software.approach
    limits, end = approach.limits, approach.end(briefing.target, lander)
    margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
    return Descent(
        flight.state.position, flight.state.velocity, flight.state.mass, end.position,
        end.velocity, briefing.weight, lander.thrust_min + margin, lander.thrust_max - margin,
        lander.exhaust_velocity, lander.dry_mass + limits.reserve, limits.max_tilt,
        limits.glideslope, _DROP,
    )  # fmt: skip


def fly(task: Task) -> list[Flown]:
    """Fly one start under every law."""
    rows, optimum = [], float("nan")
    for law in task.laws:
        scenario = scenario_of(law, task.position_sigma, task.velocity_sigma)
        flight = Simulation(scenario, flight_seed(task.seed, task.flight), world=ground())
        if np.isnan(optimum):
            optimum = _optimum(task, flight)
        rows.append(_flown(law, task.flight, flight, optimum))
    return rows


def _optimum(task: Task, flight: Simulation) -> float:
    """Return the least propellant from a flight's true start, kg."""
    try:
        return least_propellant(Planner(60), problem(flight)).propellant
    except (InputError, SolverError) as error:
        raise InputError(
            "--position-sigma, --velocity-sigma", [task.position_sigma, task.velocity_sigma],
            f"starts that can be flown from, which flight {task.flight} of seed {task.seed} has "
            f"not: {error}",
        ) from None  # fmt: skip


def _steady(briefing: Briefing, mass: float) -> float:
    """Return the propellant of the vertical descent after the approach at a constant speed, kg."""
    approach = briefing.software.approach
    increment = briefing.weight * approach.vertical_altitude / approach.vertical_speed
    return float(mass * -np.expm1(-increment / briefing.lander.exhaust_velocity))


def _flown(law: str, number: int, flight: Simulation, optimum: float) -> Flown:
    computer = flight.computer
    wet, end = flight.state.mass, computer.approach.end(computer.site, computer.lander)
    while not flight.done and computer.phase == APPROACH:
        flight.step()
    at_end, believed = flight.state, flight.estimate
    while not flight.done:
        flight.step()
    verdict = flight.verdict
    fell = sum(name == "guidance-fallback" for _, name, _ in computer.telemetry)
    return Flown(
        law, number, optimum, _steady(computer.briefing, wet - optimum),
        wet - at_end.mass, wet - flight.state.mass,
        float(np.linalg.norm(believed.position - end.position)),
        float(np.linalg.norm(at_end.velocity - end.velocity)),
        bool(verdict.safe), " ".join(verdict.failed), fell,
        *(int(getattr(computer.guidance, name, 0)) for name in ("plans", "asked", "infeasible")),
    )  # fmt: skip


def table_of(rows: list[Flown]) -> Table:
    """Return a row a law."""
    table = Table(title="Propellant to the end of the approach over the optimum")
    for heading in (
        "law", "flights", "landed safe [95 %]", "over the optimum %\nmedian / 95 % / max",
        "to the ground %\nmedian / 95 % / max", "kg to the ground\nmedian / 95 %",
        "ends off m\nmedian / 95 %", "ends off m/s\nmedian / 95 %", "flights that\nfell back",
        "answers that\nbroke limits",
    ):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "law" else "right")
    for law in dict.fromkeys(r.law for r in rows):
        mine = [r for r in rows if r.law == law]
        safe = Proportion(sum(r.safe for r in mine), len(mine))

        def spread(name: str, mine: list[Flown] = mine) -> tuple[float, float, float]:
            values = np.array([getattr(r, name) for r in mine])
            return float(np.median(values)), float(np.percentile(values, 95)), float(values.max())

        over, down = (
            " / ".join(f"{100.0 * v:.2f}" for v in spread(name)) for name in ("over", "all_over")
        )
        low, high = safe.interval
        table.add_row(
            law, str(len(mine)), f"{safe.value:.3f} [{low:.3f}, {high:.3f}]", over, down,
            " / ".join(f"{v:.1f}" for v in spread("whole")[:2]),
            " / ".join(f"{v:.2f}" for v in spread("miss")[:2]),
            " / ".join(f"{v:.2f}" for v in spread("speed")[:2]),
            str(sum(r.fallbacks > 0 for r in mine)), _answers(mine),
        )  # fmt: skip
    return table


def _answers(rows: list[Flown]) -> str:
    """Return how many answers of a network broke the limits; nothing of other laws."""
    asked = sum(r.asked for r in rows)
    return f"{sum(r.infeasible for r in rows)} of {asked:,}" if asked else ""


@click.command()
@click.option("--flights", type=click.IntRange(min=1), default=20, show_default=True,
              help="Starts.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Processes; results do not depend on it.")  # fmt: skip
@click.option("--laws", multiple=True, type=click.Choice(sorted(kinds("guidance"))),
              help="Left out: all.")  # fmt: skip
@click.option("--position-sigma", type=click.FloatRange(min=0.0), default=20.0, show_default=True,
              help="Of the start, an axis, m.")  # fmt: skip
@click.option("--velocity-sigma", type=click.FloatRange(min=0.0), default=1.5, show_default=True,
              help="Of the start, an axis, m/s.")  # fmt: skip
@click.option("--json", "out", type=click.Path(path_type=Path), help="Every flight.")
def main(
    flights: int,
    seed: int,
    jobs: int,
    laws: tuple[str, ...],
    position_sigma: float,
    velocity_sigma: float,
    out: Path | None,
) -> None:
    """Fly every law from the same starts and print what each spends over the optimum."""
    console = plain_console(178)
    chosen = laws or tuple(kinds("guidance"))
    tasks = [Task(chosen, n, seed, position_sigma, velocity_sigma) for n in range(flights)]
    try:
        if out is not None:
            check_output("--json", out, ".json")
        rows = [row for some in gathered(fly, tasks, jobs, console, "flights") for row in some]
    except InputError as error:
        raise click.UsageError(str(error)) from None
    console.print(table_of(rows))
    for row in rows:
        if not row.safe:
            console.print(f"{row.law}, flight {row.flight}: {row.failed}")
    if out is not None:
        out.write_text(json.dumps([asdict(row) for row in rows], indent=1))


if __name__ == "__main__":
    main()
