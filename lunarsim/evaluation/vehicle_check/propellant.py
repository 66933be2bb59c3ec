"""Propellant of the nominal descent, of a divert and of the thrusters."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lunarsim.evaluation.vehicle_check.attitude import agility, control_torque
from lunarsim.evaluation.vehicle_check.disturbance import offset_torques
from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.evaluation.vehicle_check.rows import CheckRow
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import STANDARD_GRAVITY
from lunarsim.onboard.control.allocation import ThrusterAllocation

# Rotations of a descent with one divert: approach, divert, its reversal and pitch-over.
_ROTATIONS = 4
_KEYS = "vehicle.propellant_mass_kg"


def propellant_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of propellant.

    Propellant of a phase is ``m0 (1 - exp(-dv / v_e))`` with its delta-v. The reserve is what must
    remain at the end of the approach: the terminal descent may use it, so the larger one of both
    counts. The divert is the maximum over directions to the edge of the mapped area at the first
    decision.
    """
    lander, reserve = mission.lander, mission.software.approach.reserve
    nominal = mission.braking_propellant + mission.approach.path.propellant
    nominal += max(mission.terminal.propellant, reserve)
    yield CheckRow(
        "propellant-nominal", "propellant", "propellant for approach and reserve",
        nominal, lander.propellant_mass, "kg",
        f"Otherwise the tanks are empty before touchdown: raise {_KEYS}, lower "
        "approach.reserve_kg, or start closer to the target.", wanted_margin=0.05,
    )  # fmt: skip
    if mission.allows_diverts:
        yield CheckRow(
            "propellant-divert", "propellant",
            "propellant for the same descent with a divert to the edge of the map",
            nominal + mission.edge_propellant, lander.propellant_mass, "kg",
            "Otherwise safe sites near the edge of the map are refused for lack of propellant: "
            f"raise {_KEYS}, lower approach.reserve_kg, or reduce size_m of the map.",
            wanted_margin=0.05,
        )  # fmt: skip
        yield CheckRow(
            "divert-reach", "propellant",
            "radius in reach at the first decision against half the radius of the map",
            0.5 * mission.edge, mission.reach, "m",
            "Otherwise most of the mapped sites are out of reach: raise "
            "decisions.first_altitude_m, approach.max_tilt_deg or vehicle.thrust_max_n.",
            wanted_margin=0.99,
        )  # fmt: skip
    if isinstance(lander, JetLander) and getattr(mission.software.control, "torques", True):
        yield _thruster_row(mission, lander)


def thruster_propellant(lander: JetLander, angular_impulse: float, axis: int) -> float:
    """Return the propellant for an angular impulse (N m s) about a body axis, kg.

    With the minimum total thrust k per torque (1/m) of `ThrusterAllocation`, it is ``k H / (Isp
    g0)``.
    """
    direction = np.eye(3)[axis]
    per_torque = float(ThrusterAllocation(lander.thrusters).group_thrust(direction).sum())
    exhaust = lander.thrusters.specific_impulse * STANDARD_GRAVITY
    return per_torque * angular_impulse / exhaust


def _thruster_row(mission: Mission, lander: JetLander) -> CheckRow:
    """Return the row of the thrusters' propellant.

    The angular impulse is that of four rotations, ``2 I w`` each with the peak rate w, and of the
    steady torques that the gimbal does not remove. A factor of 2 is wanted for the limit cycle.
    """
    able, inertia = agility(mission), float(lander.inertia(mission.start_mass)[:2].max())
    u = mission.approach.path.direction
    angle = max(
        [d.rotation for d in mission.diverts],
        default=float(np.arccos(np.clip(u @ u[0], -1.0, 1.0)).max()),
    )
    peak = min(able.slew_limit, float(np.sqrt(able.start * angle)))
    time = mission.approach.path.duration + mission.terminal.duration
    thrust = float(np.mean(mission.approach.path.thrust))
    steady = [max(offset_torques(lander, m, thrust)) for m in (mission.start_mass, lander.dry_mass)]
    steady_torque = min(0.5 * sum(steady), float(control_torque(lander)[:2].max()))
    impulse = _ROTATIONS * 2.0 * inertia * peak + steady_torque * time
    need = max(thruster_propellant(lander, impulse, axis) for axis in (0, 1))
    return CheckRow(
        "propellant-thrusters", "propellant", "propellant of the thrusters for rotations and trim",
        need, lander.thrusters.propellant, "kg",
        "Otherwise the lander loses attitude control before touchdown: raise "
        "vehicle.thrusters.propellant_kg, or remove the engine's offset torque.",
        wanted_margin=1.0,
    )  # fmt: skip
