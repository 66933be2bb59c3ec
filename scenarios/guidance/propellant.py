"""Compare the propellant of all guidance laws with the optimum on paired flights.

Every law flies from the same starts, scattered around the planned one, to the same site without
diverts. The optimum of each flight is computed by `lunarsim.optimal` from its true start with the
same throttle margin, tilt limit, glideslope and reserve, for a point mass without actuator lags.
The propellant of a law is the mass lost until the end of the approach. A law that ends the approach
at another position or velocity than commanded can use less than this optimum. The table therefore
also reports the terminal errors, and the propellant down to touchdown relative to the optimum plus
a steady vertical descent.

python scenarios/guidance/propellant.py --flights 300 --jobs 2 --out build/propellant
"""

from __future__ import annotations

from functools import cache
from typing import Any

import click
import numpy as np

from lunarsim import InputError, RandomStreams, Scenario, Simulation, build_world, flight_seed
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.phases import Phase
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent
from lunarsim.parts.registry import kinds
from lunarsim.studies import Case, Metric, Report, Study, metric_table, run_script
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
    return Descent(
        flight.state.position, flight.state.velocity, flight.state.mass, end.position,
        end.velocity, briefing.surface_gravity, *limits.thrust_range(lander),
        lander.exhaust_velocity, lander.dry_mass + limits.reserve, limits.max_tilt,
        limits.glideslope, _APEX_DEPTH_M,
    )  # fmt: skip


@cache
def minimum_propellant(
    number: int, seed: int, position_sigma: float, velocity_sigma: float
) -> float:
    """Return the minimum propellant from the true start of a flight, kg."""
    flight = Simulation(
        scenario_of("apollo", position_sigma, velocity_sigma), flight_seed(seed, number),
        world=shared_world(),
    )  # fmt: skip
    try:
        return minimize_propellant(Planner(60), optimal_descent_problem(flight)).propellant
    except (InputError, SolverError) as error:
        raise InputError(
            "--position-sigma, --velocity-sigma", [position_sigma, velocity_sigma],
            f"must give every flight a feasible descent, but flight {number} has none", str(error),
        ) from None  # fmt: skip


def _vertical_descent_propellant(briefing: Briefing, mass: float) -> float:
    """Return the propellant of the final vertical descent at constant speed, kg.

    `mass` is the vehicle mass at its start, the end of the approach, kg.
    """
    approach = briefing.software.approach
    increment = briefing.surface_gravity * approach.vertical_altitude / approach.vertical_speed
    return float(mass * -np.expm1(-increment / briefing.lander.exhaust_velocity))


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight with one guidance law; compare it with the optimum.

    The row has, in kg, the minimum propellant to the end of the approach ("optimum"), that of a
    steady vertical descent after it ("descent"), and the propellant used to the end of the approach
    ("approach") and to touchdown ("total"), with their excess in percent. "miss" and "speed" are
    the errors of position (navigation frame) and velocity at the end of the approach, m and m/s.
    "network_evaluations" and "infeasible" count the evaluations of the law's neural network, and
    those of its outputs that violate the limits of the law.
    """
    sigmas = case["position_sigma"], case["velocity_sigma"]
    optimum = minimum_propellant(case.number, case.seed, *sigmas)
    seed = flight_seed(case.seed, case.number)
    flight = Simulation(scenario_of(case["law"], *sigmas), seed, world=shared_world())
    computer = flight.computer
    wet, end = flight.state.mass, computer.approach.end(computer.site, computer.lander)
    while not flight.done and computer.phase == Phase.APPROACH:
        flight.step()
    at_end, estimate = flight.state, flight.estimate
    while not flight.done:
        flight.step()
    outcome, law = flight.outcome, computer.guidance
    descent = _vertical_descent_propellant(computer.briefing, wet - optimum)
    approach, total = wet - at_end.mass, wet - flight.state.mass
    return {
        "optimum": optimum, "descent": descent, "approach": approach, "total": total,
        "excess_to_approach_end": 100.0 * (approach / optimum - 1.0),
        "excess_to_touchdown": 100.0 * (total / (optimum + descent) - 1.0),
        "miss": float(np.linalg.norm(estimate.position - end.position)),
        "speed": float(np.linalg.norm(at_end.velocity - end.velocity)),
        "safe": bool(outcome.safe), "failed": " ".join(outcome.failure_causes),
        "fallbacks": sum(name == "guidance-fallback" for _, name, _ in computer.telemetry),
        "plans": int(getattr(law, "plans", 0)),
        "network_evaluations": int(getattr(law, "evaluation_count", 0)),
        "infeasible": int(getattr(law, "violation_count", 0)),
    }  # fmt: skip


def print_propellant(report: Report) -> None:
    """Print propellant and terminal errors by guidance law, then the unsafe landings."""
    report.print(metric_table(report, "Propellant of guidance laws relative to the optimum"))
    for (law,), rows in report.groups("law").items():
        evaluations = sum(row["network_evaluations"] for row in rows)
        infeasible = sum(row["infeasible"] for row in rows)
        if evaluations:
            report.print(f"{law}: infeasible network outputs: {infeasible} of {evaluations:,}")
    for row in report.rows:
        if not row["safe"]:
            report.print(f"{row['law']}, flight {row['number']}: {row['failed']}")


study = Study(
    fly,
    repeats="flights",
    count=20,
    factors={"law": list(kinds("guidance", with_files=False))},
    factor_help={"law": "Guidance law to fly."},
    metrics={
        "safe": Metric("safe landings\n[95 % interval]", "share"),
        "excess_to_approach_end": Metric(
            "excess to approach end (%)\nmedian / 95th pct. / max", "median-p95-max", 2
        ),
        "excess_to_touchdown": Metric(
            "excess to touchdown (%)\nmedian / 95th pct. / max", "median-p95-max", 2
        ),
        "total": Metric("propellant (kg)\nmedian / 95th pct.", "median-p95", 1),
        "miss": Metric("position error (m)\nmedian / 95th pct.", "median-p95", 2),
        "speed": Metric("velocity error (m/s)\nmedian / 95th pct.", "median-p95", 2),
        "fallbacks": Metric("flights with\nfallbacks", "count"),
    },
    report=print_propellant,
    options=(
        click.Option(
            ["--position-sigma"], type=click.FloatRange(min=0.0), default=20.0, show_default=True,
            help="Random deviation of the start position, 1 sigma per axis (m).",
        ),
        click.Option(
            ["--velocity-sigma"], type=click.FloatRange(min=0.0), default=1.5, show_default=True,
            help="Random deviation of the start velocity, 1 sigma per axis (m/s).",
        ),
    ),
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
