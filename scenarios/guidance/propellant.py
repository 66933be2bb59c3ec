"""Compare the propellant of all guidance laws with the optimum on paired flights.

Every law flies from the same starts, scattered around the planned one, to the same site without
diverts. The optimum of each flight is computed by `lunarsim.optimal` from its true start with the
same throttle margin, tilt limit, glideslope and reserve, for a point mass without actuator lags.
The propellant of a law is the mass lost until the end of the approach. A law that ends the approach
at another position or velocity than commanded can use less than this optimum. The table therefore
also reports the terminal errors, and the propellant down to touchdown relative to the optimum plus
a steady vertical descent.

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

from lunarsim import InputError, RandomStreams, Scenario, Simulation, build_world, flight_seed
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.errors import check_output
from lunarsim.evaluation.statistics import Proportion
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.computer import APPROACH
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent
from lunarsim.parts.registry import kinds
from lunarsim.world import World

# A vehicle without maps over a small terrain. The position fixes have a small bias because no map
# corrects the height of the site.
BASE_SCENARIO: dict[str, Any] = {
    "name": "propellant",
    "terrain": {"kind": "fractal", "size_m": 200.0, "rms_slope_deg": 1.0},
    "rocks": {"cover": 0.01},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "navigation": {"kind": "fixes"},
    "mappers": {},
    "tasking": {},
}
SEEKING = "information-seeking"
# Extra sensors of the information-seeking law: a LiDAR and a map of its returns. The other laws
# have none, and no law retargets.
SEEKING_SENSORS: dict[str, Any] = {
    "sensors": {**BASE_SCENARIO["sensors"], "flash": {"kind": "flash-lidar"}},
    "mappers": {
        "dem": {"kind": "gaussian-dem", "sensor": "flash", "size_m": 60.0, "posting_m": 0.25}
    },
    "tasking": {"flash": {"kind": "at-altitudes", "altitudes_m": [300.0, 200.0, 130.0, 80.0]}},
}
_APEX_DEPTH_M = 0.5  # glideslope apex below the end point, m; the same for all laws


@dataclass(frozen=True)
class PropellantTask:
    """Settings of the flights from one start, one with each guidance law.

    `flight` and `seed` (root seed) determine the start; `position_sigma` (m) and `velocity_sigma`
    (m/s) are its scatter, 1 sigma per axis.
    """

    laws: tuple[str, ...]
    flight: int
    seed: int
    position_sigma: float
    velocity_sigma: float


@dataclass(frozen=True)
class LawFlight:
    """Results of one flight with one guidance law.

    Attributes
    ----------
    law, flight
        Kind of the guidance law, and number of the flight.
    optimum, descent
        Minimum propellant to the end of the approach from the true start, and propellant of a
        steady vertical descent after it, kg.
    approach, whole
        Propellant used to the end of the approach, and to touchdown, kg.
    miss, speed
        Position error (in the navigation frame) and velocity error at the end of the approach, m
        and m/s.
    safe, failed
        Whether the landing was safe, and the failed criteria.
    fallbacks, plans
        Number of fallbacks to a simpler law and of trajectories planned by the optimal law.
    asked, infeasible
        Number of evaluations of the neural network of the law, and of its outputs that violate the
        limits of the law; 0 without a network.
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
    def excess_to_approach_end(self) -> float:
        """Propellant used to the end of the approach divided by the optimum, minus 1."""
        return self.approach / self.optimum - 1.0

    @property
    def excess_to_touchdown(self) -> float:
        """Propellant to touchdown divided by optimum plus vertical descent, minus 1."""
        return self.whole / (self.optimum + self.descent) - 1.0


def scenario_of(law: str, position_sigma: float, velocity_sigma: float) -> Scenario:
    """Return the scenario for a guidance law.

    `position_sigma` (m) and `velocity_sigma` (m/s) are the scatter of the start, 1 sigma per axis.
    """
    start = {"position_sigma_m": position_sigma, "velocity_sigma_m_s": velocity_sigma}
    sensors = SEEKING_SENSORS if law == SEEKING else {}
    return Scenario.from_dict(
        {**BASE_SCENARIO, **sensors, "start": start, "guidance": {"kind": law}}
    )


@cache
def shared_world() -> World:
    """Build the terrain of all flights; the result is cached."""
    return build_world(scenario_of("apollo", 0.0, 0.0), RandomStreams(1))


def optimal_descent_problem(flight: Simulation) -> Descent:
    """Return the minimum-propellant problem from the true state to the approach end."""
    briefing = flight.briefing
    lander, approach = briefing.lander, briefing.software.approach
    limits, end = approach.limits, approach.end(briefing.target, lander)
    margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
    return Descent(
        flight.state.position, flight.state.velocity, flight.state.mass, end.position,
        end.velocity, briefing.surface_gravity, lander.thrust_min + margin,
        lander.thrust_max - margin,
        lander.exhaust_velocity, lander.dry_mass + limits.reserve, limits.max_tilt,
        limits.glideslope, _APEX_DEPTH_M,
    )  # fmt: skip


def fly(task: PropellantTask) -> list[LawFlight]:
    """Simulate the flights from one start, one with each guidance law."""
    rows, optimum = [], float("nan")
    for law in task.laws:
        scenario = scenario_of(law, task.position_sigma, task.velocity_sigma)
        flight = Simulation(scenario, flight_seed(task.seed, task.flight), world=shared_world())
        if np.isnan(optimum):
            optimum = _minimum_propellant(task, flight)
        rows.append(_fly_law(law, task.flight, flight, optimum))
    return rows


def _minimum_propellant(task: PropellantTask, flight: Simulation) -> float:
    """Return the minimum propellant from a flight's true start, kg."""
    try:
        return minimize_propellant(Planner(60), optimal_descent_problem(flight)).propellant
    except (InputError, SolverError) as error:
        raise InputError(
            "--position-sigma, --velocity-sigma", [task.position_sigma, task.velocity_sigma],
            f"must give every flight a feasible descent, but flight {task.flight} has none",
            str(error),
        ) from None  # fmt: skip


def _vertical_descent_propellant(briefing: Briefing, mass: float) -> float:
    """Return the propellant of the final vertical descent at constant speed, kg.

    `mass` is the vehicle mass at its start, the end of the approach, kg.
    """
    approach = briefing.software.approach
    increment = briefing.surface_gravity * approach.vertical_altitude / approach.vertical_speed
    return float(mass * -np.expm1(-increment / briefing.lander.exhaust_velocity))


def _fly_law(law: str, number: int, flight: Simulation, optimum: float) -> LawFlight:
    """Simulate one flight with one guidance law; compare it with the optimum.

    `number` is the number of the flight, `optimum` the minimum propellant, kg.
    """
    computer = flight.computer
    wet, end = flight.state.mass, computer.approach.end(computer.site, computer.lander)
    while not flight.done and computer.phase == APPROACH:
        flight.step()
    at_end, believed = flight.state, flight.estimate
    while not flight.done:
        flight.step()
    outcome = flight.outcome
    fell = sum(name == "guidance-fallback" for _, name, _ in computer.telemetry)
    return LawFlight(
        law, number, optimum, _vertical_descent_propellant(computer.briefing, wet - optimum),
        wet - at_end.mass, wet - flight.state.mass,
        float(np.linalg.norm(believed.position - end.position)),
        float(np.linalg.norm(at_end.velocity - end.velocity)),
        bool(outcome.safe), " ".join(outcome.failure_causes), fell,
        *(int(getattr(computer.guidance, name, 0)) for name in ("plans", "evaluation_count",
        "violation_count")),
    )  # fmt: skip


def table_of(rows: list[LawFlight]) -> Table:
    """Return the table of propellant and terminal errors, one row per guidance law."""
    table = Table(title="Propellant of guidance laws relative to the optimum")
    for heading in (
        "law", "flights", "safe landings\n[95 % interval]",
        "excess to approach end (%)\nmedian / 95th pct. / max",
        "excess to touchdown (%)\nmedian / 95th pct. / max", "propellant (kg)\nmedian / 95th pct.",
        "position error (m)\nmedian / 95th pct.", "velocity error (m/s)\nmedian / 95th pct.",
        "flights with\nfallbacks",
        "infeasible\nnetwork outputs",
    ):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "law" else "right")
    for law in dict.fromkeys(r.law for r in rows):
        mine = [r for r in rows if r.law == law]
        safe = Proportion(sum(r.safe for r in mine), len(mine))

        def spread(name: str, mine: list[LawFlight] = mine) -> tuple[float, float, float]:
            values = np.array([getattr(r, name) for r in mine])
            return float(np.median(values)), float(np.percentile(values, 95)), float(values.max())

        over, down = (
            " / ".join(f"{100.0 * v:.2f}" for v in spread(name))
            for name in ("excess_to_approach_end", "excess_to_touchdown")
        )
        low, high = safe.interval
        table.add_row(
            law, str(len(mine)), f"{safe.value:.3f} [{low:.3f}, {high:.3f}]", over, down,
            " / ".join(f"{v:.1f}" for v in spread("whole")[:2]),
            " / ".join(f"{v:.2f}" for v in spread("miss")[:2]),
            " / ".join(f"{v:.2f}" for v in spread("speed")[:2]),
            str(sum(r.fallbacks > 0 for r in mine)), _infeasible_text(mine),
        )  # fmt: skip
    return table


def _infeasible_text(rows: list[LawFlight]) -> str:
    """Format infeasible network outputs as "count of total"; empty without network."""
    asked = sum(r.asked for r in rows)
    return f"{sum(r.infeasible for r in rows)} of {asked:,}" if asked else ""


@click.command()
@click.option("--flights", type=click.IntRange(min=1), default=20, show_default=True,
              help="Number of start states; every law flies each of them.")  # fmt: skip
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option("--laws", multiple=True, type=click.Choice(sorted(kinds("guidance"))),
              help="Guidance law to fly; repeat the option for several laws (default: "
              "all).")  # fmt: skip
@click.option("--position-sigma", type=click.FloatRange(min=0.0), default=20.0, show_default=True,
              help="Random deviation of the start position, 1 sigma per axis (m).")  # fmt: skip
@click.option("--velocity-sigma", type=click.FloatRange(min=0.0), default=1.5, show_default=True,
              help="Random deviation of the start velocity, 1 sigma per axis (m/s).")  # fmt: skip
@click.option(
    "--json",
    "out",
    type=click.Path(path_type=Path),
    help="JSON file for the results of all flights. Default: none.",
)
def main(
    flights: int,
    seed: int,
    jobs: int,
    laws: tuple[str, ...],
    position_sigma: float,
    velocity_sigma: float,
    out: Path | None,
) -> None:
    """Fly every guidance law from the same starts; compare with the optimum."""
    console = plain_console(178)
    chosen = laws or tuple(kinds("guidance"))
    tasks = [
        PropellantTask(chosen, n, seed, position_sigma, velocity_sigma) for n in range(flights)
    ]
    try:
        if out is not None:
            check_output("--json", out, ".json")
        rows = [
            row for some in collect_results(fly, tasks, jobs, console, "flights") for row in some
        ]
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
