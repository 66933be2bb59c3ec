"""Attitude authority: rotations, disturbance torques and the control's parameters."""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np

from lunarsim.evaluation.vehicle_check.descent import path_shape
from lunarsim.evaluation.vehicle_check.mission import Divert, Mission
from lunarsim.evaluation.vehicle_check.rows import Check, Found, one
from lunarsim.frames import angle_between
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import STANDARD_GRAVITY, Lander
from lunarsim.models.thrusters import Thrusters
from lunarsim.onboard.control.allocation import ThrusterAllocation
from lunarsim.onboard.control.phase_plane import PhasePlane
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.typing import Array

# The phase-plane law brakes rotations with half of the authority (`PhasePlane.rate_change`).
_PHASE_PLANE_SHARE = 0.5
# Extension of the time-to-go after a late rotation. The factor is chosen, not derived. It separates
# the default thrusters (needed over allowed time: 0.9; they land as safely as ideal attitude
# control, docs/validation/actuators.md) from a lander of 1.9 t with thrusters of 50 N (1.1), whose
# attitude oscillates after diverts. A ratio near 1 is therefore no proof in either direction:
# scenarios/landers/lunar_module.toml has 1.1 and lands if it needs no late divert.
_EXTENSION = 2.0
# Fill fractions at which slosh is examined.
_FILLS = (1.0, 0.75, 0.5, 0.25, 0.1)
# Rotations of a descent with one divert: approach, divert, its reversal and pitch-over.
_ROTATIONS = 4


# --- formulas ------------------------------------------------------------------------------------


@lru_cache(maxsize=16)
def allocation_of(thrusters: Thrusters) -> ThrusterAllocation:
    """Return the allocation of torques to thrusters, cached."""
    return ThrusterAllocation(thrusters)


def tilt_torque(lander: Lander) -> float:
    """Return the maximum torque about the weakest horizontal body axis, N m.

    Thrusters in four clusters on the diagonals have 0.71 times the torque about a diagonal that
    they have about body x, because two clusters lie on this axis. Torques of other landers are
    limited about each body axis.
    """
    if not isinstance(lander, JetLander):
        return float(min(lander.torque_max[:2]))
    allocation, angles = allocation_of(lander.thrusters), np.linspace(0.0, 2.0 * np.pi, 17)
    # A torque beyond the authority is scaled down along its direction.
    much = 1e3 * float(np.abs(lander.thrusters.torques).sum())
    axes = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(17)))
    return min(float(allocation.impulse(allocation.on_times(much * a, 1.0)) @ a) for a in axes)


def rotation_time(angle: float, acceleration: float, max_rate: float) -> float:
    """Return the shortest time of a rest-to-rest rotation, s.

    A bang-bang manoeuvre takes ``2 sqrt(angle / acceleration)``. If its peak rate ``sqrt(angle
    acceleration)`` exceeds the maximum rate w, the lander coasts in between and needs ``angle / w +
    w / acceleration``. `angle` is in rad, `acceleration` in rad/s^2, `max_rate` in rad/s.
    """
    if angle <= 0.0:
        return 0.0
    if np.sqrt(angle * acceleration) <= max_rate:
        return float(2.0 * np.sqrt(angle / acceleration))
    return float(angle / max_rate + max_rate / acceleration)


def delay_margin(k_r: float, k_v: float) -> float:
    """Return the delay (s) at which the loop ``a = -k_r x - k_v v`` is unstable.

    `k_r` is in 1/s^2 and `k_v` in 1/s. The loop gain is 1 at the frequency w with ``w^4 = k_r^2 +
    k_v^2 w^2``; the phase margin there is ``atan(k_v w / k_r)``, and the delay margin is phase over
    frequency.
    """
    w = np.sqrt(0.5 * (k_v**2 + np.sqrt(k_v**4 + 4.0 * k_r**2)))
    return float(np.arctan2(k_v * w, k_r) / w)


def guidance_delay(mission: Mission, time_to_go: float) -> float:
    """Return the delay (s) of attitude that guidance tolerates at a time-to-go T (s).

    A law with the powers p and q of T feeds back ``a = -k_r x / T^2 - k_v v / T`` with ``k_r = (p +
    2) (q + 2)`` and ``k_v = p + q + 3`` (Lu 2020). At constant T, its delay margin is 0.20 T for
    the Apollo law and 0.29 T for E-guidance. Guidance also compensates the response time of the
    control.
    """
    p, q = path_shape(mission.software.guidance).powers
    margin = delay_margin((p + 2.0) * (q + 2.0), p + q + 3.0)
    return margin * time_to_go + float(mission.software.control.response_time)


def slew_limit(mission: Mission) -> float:
    """Return the maximum rate that the attitude control commands, rad/s; inf: no limit."""
    return float(getattr(mission.software.control, "slew_limit", np.inf))


def tilt_acceleration(mission: Mission, mass: float) -> float:
    """Return the angular acceleration with which the lander can tilt at a mass (kg), rad/s^2.

    It is ``tilt_torque / I`` with the larger horizontal moment of inertia. A control that brakes
    with the share s of the acceleration a needs the time of a rotation with the harmonic mean ``2 a
    s / (1 + s)``. Control that commands no torques has no limit.
    """
    if not has_torques(mission):
        return np.inf
    share = _PHASE_PLANE_SHARE if isinstance(mission.software.control, PhasePlane) else 1.0
    inertia = float(mission.lander.inertia(mass)[:2].max())
    return tilt_torque(mission.lander) / inertia * 2.0 * share / (1.0 + share)


def has_torques(mission: Mission) -> bool:
    """Return whether the attitude control commands torques."""
    return bool(getattr(mission.software.control, "torques", True))


def turn_time(mission: Mission, angle: float, mass: float | None = None) -> float:
    """Return the time of a rotation by an angle (rad) at a mass (kg; None: at the start), s."""
    acceleration = tilt_acceleration(mission, mission.start_mass if mass is None else mass)
    return rotation_time(angle, acceleration, slew_limit(mission))


def trim_and_rest(lander: JetLander, mass: float, thrust: float) -> tuple[Array, Array]:
    """Return gimbal angles that trim the engine (2,), rad, and torques that remain (2,), N m.

    Both are about body x and y. With the offset c of the centre of mass from the engine's axis, the
    arm a from the gimbal's pivot to the centre of mass and the gimbal angle d, the torque is ``F (c
    cos d - a sin d)``. The gimbal removes it at ``tan d = c / a``; beyond its limit the rest
    remains. `mass` is in kg, `thrust` F in N.
    """
    com = lander.com(mass)
    arm, offset = max(lander.engine.pivot_depth + float(com[2]), 1e-6), np.abs(com[[1, 0]])
    trim = np.arctan2(offset, arm)
    d = np.minimum(trim, lander.engine.gimbal_limit)
    return trim, np.maximum(thrust * (offset * np.cos(d) - arm * np.sin(d)), 0.0)


def slosh_torque(
    lander: JetLander, fill: float, acceleration: float, angle: float, turn: float
) -> float:
    """Return the torque of sloshing propellant after a rotation of the lander, N m.

    A pendulum of mass m hangs under the thrust acceleration a at the height z of its hinge above
    the centre of mass. At the swing angle s it pulls with ``m a sin s`` across the body, and the
    torque is ``m a |z| sin s``. A rotation by an angle in the time t leaves at most the swing
    ``angle min(1, T / (pi t))``, with the pendulum's period ``T = 2 pi sqrt(L / a)`` (response of
    an undamped oscillator to a ramp). `fill` is the remaining fraction of the propellant,
    `acceleration` in m/s^2, `angle` in rad and `turn`, the duration of the rotation, in s.
    """
    masses, lengths, bobs = lander.slosh.pendulums(fill, lander.propellant_mass)
    com = lander.com(lander.dry_mass + fill * lander.propellant_mass)
    period = 2.0 * np.pi * np.sqrt(lengths / acceleration)
    swing = angle * np.minimum(1.0, period / (np.pi * max(turn, 1e-6)))
    side = masses * acceleration * np.sin(np.minimum(swing, 0.5 * np.pi))
    return float((side * np.abs(bobs[:, 2] + lengths - com[2])).sum())


# --- values of the checks ------------------------------------------------------------------------


def _approach_rotation(mission: Mission) -> list[Found]:
    """Return the rotation between two samples of the path with the largest ratio of times.

    A rest-to-rest rotation may end later than the path by twice the delay that guidance tolerates,
    because a rotation of duration t acts like a delay of t / 2.
    """
    path = mission.path
    u, time, worst = path.direction[::10], path.time[::10], (-1.0, 0.0, 0.0, 0.0)
    for i, j in combinations(range(len(time)), 2):
        angle = angle_between(u[i], u[j])
        delay = guidance_delay(mission, path.time_to_go - float(time[i]))
        allowed, needed = float(time[j] - time[i]) + 2.0 * delay, turn_time(mission, angle)
        worst = max(worst, (needed / allowed, needed, allowed, np.rad2deg(angle)))
    return one(worst[1], worst[2], angle=worst[3])


def _divert_rotation(mission: Mission) -> list[Found]:
    """Return the reachable divert whose rotation has the largest ratio of needed to allowed time.

    Guidance tolerates a rotation of duration ``t <= 2 (m T + response time)`` (`guidance_delay`).
    If commands exceed the limits, the onboard computer extends the time-to-go; twice this time is
    therefore the requirement, and this time gives a sufficient margin.
    """

    def times(d: Divert) -> tuple[float, float]:
        allowed = _EXTENSION * 2.0 * guidance_delay(mission, d.time_to_go)
        return turn_time(mission, d.rotation), allowed

    if not mission.reachable:
        return []
    d = max(mission.reachable, key=lambda d: times(d)[0] / times(d)[1])
    return one(
        *times(d), angle=np.rad2deg(d.rotation), distance=d.distance, altitude=d.altitude
    )  # fmt: skip


def _terminal_loop(mission: Mission) -> list[Found]:
    """Return the delay in the position loop of the vertical descent, and its delay margin.

    The delay is half the time of a rotation by the maximum tilt of the law, plus the lag of the
    engine. The loop of the law is ``a = -f^2 x - 2 z f v``.
    """
    settings: Any = mission.software.terminal_descent or VerticalDescent()
    if not isinstance(settings, VerticalDescent) or not has_torques(mission):
        return []
    known: Any = SimpleNamespace(
        software=mission.software, surface_gravity=mission.gravity, lander=mission.lander
    )
    lag = mission.lander.thrust_lag
    law = settings.build(known, mission.software.control.response_time + lag)
    delay = 0.5 * turn_time(mission, law.max_tilt, mission.touchdown_mass) + lag
    available = delay_margin(law.frequency**2, 2.0 * law.damping * law.frequency)
    return one(delay, available, angle=np.rad2deg(law.max_tilt))


def _braking(mission: Mission) -> list[Found]:
    """Return the angular acceleration of the lander, and the one the control needs for stopping.

    The linear loop ``rate = f / (2 z) error`` commands the slew limit w down to the error ``2 z w /
    f`` and stops in this angle without overshoot with the acceleration ``f w / (4 z)``. Quaternion
    feedback states the acceleration.
    """
    control: Any = mission.software.control
    needed = getattr(control, "braking", None)
    if needed is None and hasattr(control, "frequency") and hasattr(control, "damping"):
        needed = control.frequency * slew_limit(mission) / (4.0 * control.damping)
    if needed is None or np.isinf(needed):
        return []
    return one(tilt_acceleration(mission, mission.start_mass), needed)


def _overshoot(mission: Mission) -> list[Found]:
    """Return how far a phase-plane law can overshoot in one control period, and two dead bands.

    At the angle x outside the dead band, the law commands the rate ``min(w, sqrt(a x))`` with the
    slew limit w and the authority a, and keeps it for the period T. It passes the near edge of the
    band by at most ``a T^2 / 4``, or ``w T - w^2 / a`` if w is less than ``a T / 2``. The shortest
    pulse changes the rate by d and passes the edge by ``d T / 2``. A lander that passes both edges
    within a period oscillates.
    """
    lander, control = mission.lander, mission.software.control
    if not isinstance(lander, JetLander) or not isinstance(control, PhasePlane):
        return []
    inertia = lander.inertia(lander.dry_mass)[:2]
    a = float((allocation_of(lander.thrusters).authority[:2] / inertia).max())
    pulse = float((allocation_of(lander.thrusters).min_impulse[:2] / inertia).max())
    w, period = min(control.slew_limit, 0.5 * a * control.period), control.period
    return one(2.0 * control.dead_band, max(w * period - w**2 / a, 0.5 * pulse * period))


def _offsets(mission: Mission) -> list[tuple[float, float]]:
    """Return mass (kg) and thrust (N) for which the engine's offset is examined."""
    first_half = mission.path.thrust[: len(mission.path.thrust) // 2 + 1]
    dry = mission.lander.dry_mass
    return [(mission.start_mass, float(first_half.max())), (dry, mission.terminal_thrust)]


def _offset_torque(mission: Mission) -> list[Found]:
    """Return the engine's remaining torque with full or empty tanks, about the worse axis."""
    lander = mission.lander
    if not isinstance(lander, JetLander):
        return []
    able = allocation_of(lander.thrusters).authority[:2]
    pairs = [
        p for c in _offsets(mission) for p in zip(trim_and_rest(lander, *c)[1], able, strict=True)
    ]
    return one(*max(pairs, key=lambda pair: pair[0] / pair[1]))


def _slosh(mission: Mission) -> list[Found]:
    """Return the maximum slosh torque after the largest rotation, over fill fractions."""
    lander, angle = mission.lander, mission.largest_rotation
    if not isinstance(lander, JetLander) or not lander.slosh.tanks:
        return []
    acceleration = float(np.linalg.norm(mission.path.acceleration, axis=1).max())
    turn = turn_time(mission, angle)
    most = max(slosh_torque(lander, fill, acceleration, angle, turn) for fill in _FILLS)
    return one(most, tilt_torque(lander))


def _thruster_propellant(mission: Mission) -> list[Found]:
    """Return the propellant of the thrusters for four rotations, and what the lander has.

    A rotation needs the angular impulse ``H = 2 I w`` with its peak rate w. With the minimum total
    thrust k per torque (1/m) of `ThrusterAllocation`, the propellant is ``k H / (Isp g0)``.
    """
    lander = mission.lander
    if not isinstance(lander, JetLander):
        return []
    inertia = float(lander.inertia(mission.start_mass)[:2].max())
    alpha = tilt_acceleration(mission, mission.start_mass)
    peak = min(slew_limit(mission), float(np.sqrt(alpha * mission.largest_rotation)))
    allocation = allocation_of(lander.thrusters)
    per_torque = max(float(allocation.group_thrust(axis).sum()) for axis in np.eye(3)[:2])
    exhaust = lander.thrusters.specific_impulse * STANDARD_GRAVITY
    needed = per_torque * _ROTATIONS * 2.0 * inertia * peak / exhaust
    return one(needed, lander.thrusters.propellant)


ATTITUDE_CHECKS = (
    Check("approach-rotation-time", "attitude", "time of a rotation on the approach ({angle:.0f} "
        "deg)", "s", _approach_rotation, "the thrust lags behind guidance and the lander misses "
        "the end of the approach: raise {torque}, or control.slew_limit_deg_s, or extend "
        "approach.time_to_go_s"),
    Check("divert-rotation-time", "attitude", "time of the rotation by {angle:.0f} deg for a "
        "divert of {distance:.0f} m at {altitude:.0f} m altitude", "s", _divert_rotation,
        "guidance reacts to its own late rotations, and the tilt oscillates with growing "
        "amplitude: raise {torque}, or control.slew_limit_deg_s, or decisions.last_altitude_m",
        wanted_margin=_EXTENSION - 1.0),
    Check("terminal-loop-delay", "attitude", "delay of a tilt by {angle:.0f} deg in the terminal "
        "descent", "s", _terminal_loop, "the lander swings during the terminal descent and touches "
        "down with horizontal speed: raise {torque}, or control.slew_limit_deg_s",
        wanted_margin=0.25),
    Check("control-braking", "attitude", "angular acceleration that the control needs for stopping",
        "deg/s^2", _braking, "the torque saturates and rotations overshoot: lower "
        "control.frequency_rad_s, slew_limit_deg_s or braking_rad_s2, or raise {torque}",
        "at most"),
    Check("control-period", "attitude", "overshoot in one control period against the dead band",
        "deg", _overshoot, "each correction overshoots the opposite edge of the dead band and the "
        "attitude oscillates: lower control.period_s or vehicle.thrusters.force_n, or raise "
        "control.dead_band_deg", "at most"),
    Check("offset-torque", "disturbance", "control torque against the engine's offset torque",
        "N m", _offset_torque, "the engine rotates the lander faster than the thrusters can stop "
        "it: move vehicle.com_full_m and vehicle.com_dry_m to the engine's axis, or raise "
        "vehicle.engine.gimbal_limit_deg or vehicle.thrusters.force_n", wanted_margin=1.0),
    Check("slosh-torque", "disturbance", "control torque against the torque of sloshing propellant",
        "N m", _slosh, "slosh rotates the lander after each divert: add tanks or baffles "
        "(vehicle.slosh.tanks_m, vehicle.slosh.damping), lower vehicle.slosh.radius_m, or raise "
        "vehicle.thrusters.force_n", wanted_margin=1.0),
    Check("propellant-thrusters", "propellant", "propellant of the thrusters for rotations and "
        "trim", "kg", _thruster_propellant, "the lander loses attitude control before touchdown: "
        "raise vehicle.thrusters.propellant_kg, or remove the engine's offset torque",
        wanted_margin=1.0),
)  # fmt: skip
