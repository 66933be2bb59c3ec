"""Attitude authority: rotations, disturbance torques and the control's parameters."""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np

from lunarsim.evaluation.vehicle_check.mission import Divert, Mission
from lunarsim.evaluation.vehicle_check.rows import AT_LEAST, AT_MOST, Check, Found, one
from lunarsim.frames import angle_between
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import STANDARD_GRAVITY
from lunarsim.models.thrusters import Thrusters
from lunarsim.onboard.control.allocation import ThrusterAllocation
from lunarsim.onboard.control.phase_plane import PhasePlane
from lunarsim.onboard.guidance.rotation import (
    RotationLimits,
    delay_margin,
    guidance_delay_margin,
    path_shape,
    tilt_torque,
)
from lunarsim.typing import Array

# Tolerated extension of the time-to-go by the rotation of a divert. The factor is chosen, not
# derived: a lander beyond it flies at least twice as long to the sites of its last diverts.
_EXTENSION = 2.0
# Fill fractions at which slosh is examined.
_FILLS = (1.0, 0.75, 0.5, 0.25, 0.1)


# --- formulas ------------------------------------------------------------------------------------


@lru_cache(maxsize=16)
def allocation_of(thrusters: Thrusters) -> ThrusterAllocation:
    """Return the allocation of torques to thrusters, cached."""
    return ThrusterAllocation(thrusters)


def guidance_delay(mission: Mission, time_to_go: float) -> float:
    """Return the delay (s) of attitude that guidance tolerates at a time-to-go (s).

    It is the delay margin, and the response time of the control, which guidance compensates.
    """
    margin = guidance_delay_margin(path_shape(mission.software.guidance))
    return margin * time_to_go + float(mission.software.control.response_time)


def slew_limit(mission: Mission) -> float:
    """Return the maximum rate of the attitude control, rad/s; inf: no limit."""
    return float(getattr(mission.software.control, "slew_limit", np.inf))


def turn_time(mission: Mission, angle: float, mass: float | None = None) -> float:
    """Return the time (s) of a rotation by an angle (rad).

    `mass` is in kg; None: that at the start.
    """
    limits = RotationLimits.of(mission.lander, mission.software.control)
    return float(limits.time(angle, mission.start_mass if mass is None else mass))


def _offset_and_arm(lander: JetLander, mass: float) -> tuple[Array, float]:
    """Return the offset of the centre of mass and the gimbal's arm, m.

    The offset (2,) is from the engine's axis; it turns the lander about body x and y.
    """
    com = lander.com(mass)
    return np.abs(com[[1, 0]]), max(lander.engine.pivot_depth + float(com[2]), 0.0)


def trim_angles(lander: JetLander, mass: float, time: Array | float = np.inf) -> Array:
    """Return the gimbal angles about body x and y that trim the engine (..., 2), rad.

    They point the thrust at the centre of mass, as far as the limit and the rate of the gimbal
    allow within a `time` (...,), s. `mass` is in kg.
    """
    engine, (offset, arm) = lander.engine, _offset_and_arm(lander, mass)
    moved = engine.gimbal_rate * np.asarray(time)[..., None] if engine.gimbal_rate > 0.0 else 0.0
    return np.asarray(np.minimum(np.arctan2(offset, arm), np.minimum(engine.gimbal_limit, moved)))


def offset_torques(
    lander: JetLander, mass: float, thrust: Array | float, time: Array | float = np.inf
) -> Array:
    """Return the torque about body x and y that the gimbal leaves (..., 2), N m.

    With the offset c of the centre of mass from the engine's axis, the arm a from the gimbal's
    pivot to the centre of mass and the gimbal angle d, the torque is ``F (c cos d - a sin d)``. The
    gimbal removes it at ``tan d = c / a``; before it is there, and beyond its limit, the rest
    remains. `mass` is in kg, `thrust` F (...,) in N, and `time` (...,) since the start in s.
    """
    (offset, arm), d = _offset_and_arm(lander, mass), trim_angles(lander, mass, time)
    return np.asarray(np.asarray(thrust)[..., None] * (offset * np.cos(d) - arm * np.sin(d)))


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
    """Return needed and allowed time of the worst rotation on the approach.

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
    """Return needed and allowed time of the worst rotation at a divert.

    Guidance tolerates a rotation of duration ``t <= 2 (m T + response time)`` (`guidance_delay`).
    In flight, the onboard computer takes a longer path for a longer rotation, or refuses the
    divert. Twice this time is the requirement, and this time gives a sufficient margin.
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
    """Return delay and delay margin of the position loop of the vertical descent.

    The delay is half the time of a rotation by the maximum tilt of the law, plus the lag of the
    engine. The loop of the law is ``a = -f^2 x - 2 z f v``.
    """
    settings = mission.vertical_descent
    if settings is None:
        return []
    lander, software, lag = mission.lander, mission.software, mission.lander.thrust_lag
    known: Any = SimpleNamespace(software=software, surface_gravity=mission.gravity, lander=lander)
    law = settings.build(known, software.control.response_time + lag)
    delay = 0.5 * turn_time(mission, law.max_tilt, mission.touchdown_mass) + lag
    available = delay_margin(law.frequency**2, 2.0 * law.damping * law.frequency)
    return one(delay, available, angle=np.rad2deg(law.max_tilt))


def _braking(mission: Mission) -> list[Found]:
    """Return available and needed angular acceleration for stopping a rotation.

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
    limits = RotationLimits.of(mission.lander, control)
    return one(limits.acceleration(mission.start_mass), needed)


def _overshoot(mission: Mission) -> list[Found]:
    """Return two dead bands, and the overshoot of the law in one control period.

    At the angle x outside the dead band, the law commands the rate ``min(w, sqrt(a x))`` with the
    slew limit w and the authority a, and keeps it for the period T. It passes the near edge of the
    band by at most ``a T^2 / 4``, or ``w T - w^2 / a`` if w is less than ``a T / 2``. A lander that
    passes both edges within a period oscillates.
    """
    lander, control = mission.lander, mission.software.control
    if not isinstance(lander, JetLander) or not isinstance(control, PhasePlane):
        return []
    inertia = lander.inertia(lander.dry_mass)[:2]
    a = float((allocation_of(lander.thrusters).authority[:2] / inertia).max())
    w, period = min(control.slew_limit, 0.5 * a * control.period), control.period
    return one(2.0 * control.dead_band, w * period - w**2 / a)


def _offset_torque(mission: Mission) -> list[Found]:
    """Return the worst offset torque, with full or empty tanks, and its limit.

    With full tanks, the gimbal moves from its middle since the start.
    """
    lander, path = mission.lander, mission.path
    if not isinstance(lander, JetLander):
        return []
    able = allocation_of(lander.thrusters).authority[:2]
    half = slice(len(path.time) // 2 + 1)
    torques = offset_torques(lander, mission.start_mass, path.thrust[half], path.time[half])
    full = torques.max(axis=0)
    empty = offset_torques(lander, lander.dry_mass, mission.terminal_thrust)
    pairs = zip((*full, *empty), (*able, *able), strict=True)
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
    """Return the minimum propellant that thrusters use, and that in their tanks, kg.

    Three rotations count, each by the largest angle: away from the vertical, at a divert, and back.
    With the peak rate w and the moment of inertia I, one needs the angular impulse ``2 I w``. The
    offset torque that the gimbal leaves acts for the duration of the descent.
    """
    lander, limits = mission.lander, RotationLimits.of(mission.lander, mission.software.control)
    if not isinstance(lander, JetLander):
        return []
    inertia = lander.inertia(mission.start_mass)[:2]
    peak = np.sqrt(limits.acceleration(mission.start_mass) * mission.largest_rotation)
    impulse = 3.0 * 2.0 * inertia * min(peak, limits.max_rate)
    duration = float(mission.path.time[-1]) + mission.terminal_time
    for mass in (mission.start_mass, lander.dry_mass):
        offset = offset_torques(lander, mass, mission.terminal_thrust)
        impulse = impulse + 0.5 * duration * offset
    allocation = allocation_of(lander.thrusters)
    thrust = [float(allocation.group_thrust(axis).sum()) for axis in np.eye(3)[:2]]
    used = float((impulse * thrust).max()) / (lander.thrusters.specific_impulse * STANDARD_GRAVITY)
    return one(used, lander.thrusters.propellant)


ATTITUDE_CHECKS = (
    Check("approach-rotation-time", "attitude", "s", AT_LEAST, 0.0, _approach_rotation,
        "time of a rotation on the approach ({angle:.0f} deg)",
        "the lander misses the end of the approach: raise {torque}, control.slew_limit_deg_s or "
        "approach.time_to_go_s"),
    Check("divert-rotation-time", "attitude", "s", AT_LEAST, _EXTENSION - 1.0, _divert_rotation,
        "time of the rotation by {angle:.0f} deg for a divert of {distance:.0f} m at "
        "{altitude:.0f} m altitude",
        "the lander takes a longer path, or the site is out of reach: raise {torque}, "
        "control.slew_limit_deg_s or decisions.last_altitude_m"),
    Check("terminal-loop-delay", "attitude", "s", AT_LEAST, 0.25, _terminal_loop,
        "delay of a tilt by {angle:.0f} deg in the terminal descent",
        "the lander swings and touches down with horizontal speed: raise {torque} or "
        "control.slew_limit_deg_s"),
    Check("control-braking", "attitude", "deg/s^2", AT_MOST, 0.0, _braking,
        "angular acceleration that the control needs for stopping",
        "the torque saturates and rotations overshoot: lower control.frequency_rad_s, "
        "slew_limit_deg_s or braking_rad_s2, or raise {torque}"),
    Check("control-period", "attitude", "deg", AT_MOST, 0.0, _overshoot,
        "overshoot in one control period against the dead band",
        "the attitude oscillates: lower control.period_s or vehicle.thrusters.force_n, or raise "
        "control.dead_band_deg"),
    Check("offset-torque", "disturbance", "N m", AT_LEAST, 1.0, _offset_torque,
        "control torque against the engine's offset torque",
        "the engine rotates the lander: move vehicle.com_full_m and com_dry_m to the engine's "
        "axis, or raise vehicle.engine.gimbal_limit_deg, gimbal_rate_deg_s or "
        "vehicle.thrusters.force_n"),
    Check("slosh-torque", "disturbance", "N m", AT_LEAST, 1.0, _slosh,
        "control torque against the torque of sloshing propellant",
        "slosh rotates the lander after each divert: add tanks (vehicle.slosh.tanks_m), lower "
        "vehicle.slosh.radius_m, or raise vehicle.thrusters.force_n"),
    Check("thruster-propellant", "propellant", "kg", AT_LEAST, 1.0, _thruster_propellant,
        "propellant of the thrusters for three rotations and the engine's offset torque",
        "the lander loses its attitude control: raise vehicle.thrusters.propellant_kg or "
        "cluster_radius_m, or move vehicle.com_full_m and com_dry_m to the engine's axis"),
)  # fmt: skip
