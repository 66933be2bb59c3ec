"""Attitude authority: commanded rotations against torque and slew limit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsim.evaluation.vehicle_check.descent import path_shape
from lunarsim.evaluation.vehicle_check.mission import Divert, Mission, angle_between
from lunarsim.evaluation.vehicle_check.rows import CheckRow
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.onboard.control.allocation import ThrusterAllocation
from lunarsim.onboard.control.phase_plane import PhasePlane
from lunarsim.onboard.control.quaternion_feedback import QuaternionFeedback
from lunarsim.onboard.guidance.paths import PathShape
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.typing import Array

# The phase-plane law brakes rotations with half of the authority (`PhasePlane.rate_change`).
_PHASE_PLANE_SHARE = 0.5
# Extension of the time-to-go after a late rotation. The factor is chosen, not derived. It separates
# the default thrusters (needed over allowed time: 0.9; they land as safely as ideal attitude
# control, docs/validation/actuators.md) from a lander of 1.9 t with thrusters of 50 N (1.1), whose
# attitude oscillates after diverts. A ratio near 1 is therefore no proof in either direction:
# the lunar module with decisions down to 50 m has 1.1 and lands if it needs no late divert.
_EXTENSION = 2.0
# Rotations may take at most this multiple of the time at the control's slew limit.
_MAX_SLEW_TIME_RATIO = 2.0
_JET_KEYS = "vehicle.thrusters.force_n or vehicle.thrusters.cluster_radius_m"


def control_torque(lander: Lander) -> Array:
    """Return the maximum torque about each single body axis (3,), N m.

    For thrusters it is the sustained torque of `ThrusterAllocation`; the gimbal of the engine only
    trims steady torques and does not rotate the lander.
    """
    if isinstance(lander, JetLander):
        return np.asarray(ThrusterAllocation(lander.thrusters).authority)
    return np.asarray(lander.torque_max, dtype=np.float64)


def tilt_torque(lander: Lander) -> float:
    """Return the maximum torque about the weakest horizontal body axis, N m.

    Thrusters in four clusters on the diagonals have 0.71 times the torque about a diagonal that
    they have about body x, because two clusters lie on this axis. Torques of other landers are
    limited about each body axis.
    """
    if not isinstance(lander, JetLander):
        return float(min(lander.torque_max[:2]))
    allocation, angles = ThrusterAllocation(lander.thrusters), np.linspace(0.0, 2.0 * np.pi, 17)
    # A torque beyond the authority is scaled down along its direction.
    much = 1e3 * float(np.abs(lander.thrusters.torques).sum())
    axes = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(17)))
    return min(float(allocation.impulse(allocation.on_times(much * a, 1.0)) @ a) for a in axes)


def torque_keys(lander: Lander) -> str:
    """Return the scenario keys that determine the control torque, for advice."""
    return _JET_KEYS if isinstance(lander, JetLander) else "vehicle.torque_max_n_m"


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


def guidance_delay_margin(shape: PathShape) -> float:
    """Return the delay over the time-to-go at which guidance becomes unstable.

    A law with the powers p and q of time-to-go T feeds back ``a = -k_r x / T^2 - k_v v / T`` with
    ``k_r = (p + 2) (q + 2)`` and ``k_v = p + q + 3`` (Lu 2020). At constant T the loop gain is 1 at
    the frequency w / T with ``w^4 = k_r^2 + k_v^2 w^2``; the phase margin there is
    ``atan(k_v w / k_r)``, and the delay margin is phase over frequency. It is 0.20 for the Apollo
    law and 0.29 for E-guidance.
    """
    k_r, k_v = (shape.low + 2.0) * (shape.high + 2.0), shape.low + shape.high + 3.0
    w = np.sqrt(0.5 * (k_v**2 + np.sqrt(k_v**4 + 4.0 * k_r**2)))
    return float(np.arctan2(k_v * w, k_r) / w)


def position_loop_delay_margin(frequency: float, damping: float) -> float:
    """Return the delay (s) at which the terminal descent's position loop is unstable.

    The loop ``a = -f^2 x - 2 z f v`` has the delay margin of `guidance_delay_margin` with ``k_r =
    1``, ``k_v = 2 z`` and T = 1 / f. `frequency` f is in rad/s, and `damping` z the damping ratio.
    """
    k_v = 2.0 * damping
    w = np.sqrt(0.5 * (k_v**2 + np.sqrt(k_v**4 + 4.0)))
    return float(np.arctan(k_v * w) / w / frequency)


@dataclass(frozen=True)
class Agility:
    """Ability of a lander and its attitude control to tilt.

    Attributes
    ----------
    start, touchdown
        Angular acceleration about the weakest horizontal axis at the start and at
        touchdown, rad/s^2.
    slew_limit
        Maximum rate of the control, rad/s; inf if it has none.
    """

    start: float
    touchdown: float
    slew_limit: float

    def time(self, angle: float) -> float:
        """Return the time of a rotation by an angle (rad) at the start mass, s."""
        return rotation_time(angle, self.start, self.slew_limit)


def agility(mission: Mission) -> Agility:
    """Return the ability of the lander to tilt.

    The angular acceleration is ``tilt_torque / I`` with the larger horizontal moment of inertia. A
    control that brakes with the share s of the acceleration a needs the time of a rotation with
    the harmonic mean ``2 a s / (1 + s)``.
    """
    lander, control = mission.lander, mission.software.control
    share = _PHASE_PLANE_SHARE if isinstance(control, PhasePlane) else 1.0
    usable = tilt_torque(lander) * 2.0 * share / (1.0 + share)
    start, end = (
        usable / float(lander.inertia(m)[:2].max())
        for m in (mission.start_mass, mission.touchdown_mass)
    )
    return Agility(start, end, float(getattr(control, "slew_limit", np.inf)))


def attitude_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of attitude authority."""
    control = mission.software.control
    if not getattr(control, "torques", True):
        able = Agility(np.inf, np.inf, float(getattr(control, "slew_limit", np.inf)))
    else:
        able = agility(mission)
    yield from _path_rows(mission, able)
    yield from _divert_rows(mission, able)
    if np.isfinite(able.start):
        yield from _terminal_loop_rows(mission, able)
        yield from _control_rows(mission, able)


def _turn_keys(mission: Mission) -> str:
    return f"{torque_keys(mission.lander)}, or control.slew_limit_deg_s"


def _path_rows(mission: Mission, able: Agility) -> Iterator[CheckRow]:
    """Yield the rows of the rotations along the nominal path.

    The rotation of the approach is the largest angle between two thrust directions of the path,
    and its time the time between them. The pitch-over is the angle between the last thrust
    direction and the vertical; it must be over before touchdown.
    """
    path = mission.approach.path
    u, t = path.direction[::10], path.time[::10]
    angles = np.arccos(np.clip(u @ u.T, -1.0, 1.0))
    i, j = np.unravel_index(int(np.argmax(angles)), angles.shape)
    angle, left = float(angles[i, j]), abs(float(t[j] - t[i]))
    yield CheckRow(
        "approach-rotation-time", "attitude",
        f"time of the largest rotation on the approach ({np.rad2deg(angle):.0f} deg)",
        able.time(angle), left, "s",
        "Otherwise the thrust lags behind guidance and the lander misses the end of the approach: "
        f"raise {_turn_keys(mission)}, or extend approach.time_to_go_s.", wanted_margin=1.0,
    )  # fmt: skip
    over = angle_between(path.direction[-1], np.array([0.0, 0.0, 1.0]))
    yield CheckRow(
        "pitch-over-time", "attitude",
        f"time of the pitch-over at the end of the approach ({np.rad2deg(over):.0f} deg)",
        rotation_time(over, able.touchdown, able.slew_limit), mission.terminal.duration, "s",
        "Otherwise the lander is still tilted at touchdown: raise "
        f"{_turn_keys(mission)}, or approach.vertical_altitude_m.", wanted_margin=1.0,
    )  # fmt: skip
    if np.isfinite(able.slew_limit):
        yield CheckRow(
            "path-rotation-rate", "attitude", "slew limit against the rotation rate of the path",
            float(np.rad2deg(_path_rate(mission))), float(np.rad2deg(able.slew_limit)), "deg/s",
            "Otherwise the attitude cannot follow the planned path: raise "
            "control.slew_limit_deg_s, or extend approach.time_to_go_s.",
        )  # fmt: skip


def _path_rate(mission: Mission) -> float:
    """Return the maximum rotation rate of the thrust direction on the approach, rad/s.

    The rate is a mean over the delay that guidance tolerates: its delay margin times the
    time-to-go, at least the response time of the control. Shorter peaks only delay the rotation.
    """
    path, control = mission.approach.path, mission.software.control
    margin = guidance_delay_margin(path_shape(mission.law))
    u, most = path.direction, 0.0
    for i in range(0, len(path.time) - 1, 4):
        delay = max(margin * (mission.approach.time_to_go - path.time[i]), control.response_time)
        j = min(int(np.searchsorted(path.time, path.time[i] + delay)), len(path.time) - 1)
        if path.time[j] - path.time[i] >= 0.9 * delay > 0.0:
            most = max(most, angle_between(u[i], u[j]) / float(path.time[j] - path.time[i]))
    return most


def _divert_rows(mission: Mission, able: Agility) -> Iterator[CheckRow]:
    """Yield the row of the rotation at a divert.

    A rest-to-rest rotation of duration t acts like a delay of t / 2. Guidance compensates the
    response time of the control and tolerates a further delay of `guidance_delay_margin` times the
    time-to-go T: ``t <= 2 (m T + response time)``. If commands exceed the limits, the onboard
    computer extends the time-to-go; twice this time is therefore the requirement, and this time
    gives a sufficient margin. The row shows the reachable divert with the largest ratio.
    """
    margin = guidance_delay_margin(path_shape(mission.law))
    response = float(mission.software.control.response_time)

    def allowed(d: Divert) -> float:
        return _EXTENSION * 2.0 * (margin * d.time_to_go + response)

    if not mission.diverts:
        return
    worst = max(mission.diverts, key=lambda d: able.time(d.rotation) / allowed(d))
    yield CheckRow(
        "divert-rotation-time",
        "attitude",
        f"time of the rotation by {np.rad2deg(worst.rotation):.0f} deg for a divert of "
        f"{worst.distance:.0f} m at {worst.altitude:.0f} m altitude",
        able.time(worst.rotation),
        allowed(worst),
        "s",
        "Otherwise guidance reacts to its own late rotations, and the tilt oscillates with growing "
        f"amplitude: raise {_turn_keys(mission)}, or decisions.last_altitude_m.",
        wanted_margin=_EXTENSION - 1.0,
    )


def _terminal_loop_rows(mission: Mission, able: Agility) -> Iterator[CheckRow]:
    """Yield the row of the delay in the horizontal loop of the terminal descent.

    The delay is half the time of a rotation by the maximum tilt of the law, plus the lag of the
    engine.
    """
    law = mission.terminal_law
    law = getattr(law, "last", law)
    if not isinstance(law, VerticalDescent):
        return
    turn = rotation_time(law.max_tilt, able.touchdown, able.slew_limit)
    yield CheckRow(
        "terminal-loop-delay", "attitude",
        f"delay of a tilt by {np.rad2deg(law.max_tilt):.0f} deg in the terminal descent",
        0.5 * turn + mission.lander.thrust_lag,
        position_loop_delay_margin(law.frequency, law.damping), "s",
        "Otherwise the lander swings during the terminal descent and touches down with horizontal "
        f"speed: raise {_turn_keys(mission)}.", wanted_margin=0.25,
    )  # fmt: skip


def _control_rows(mission: Mission, able: Agility) -> Iterator[CheckRow]:
    """Yield the checks of the control's parameters against the torque."""
    control, keys = mission.software.control, torque_keys(mission.lander)
    largest = max([d.rotation for d in mission.diverts], default=0.0)
    u = mission.approach.path.direction
    largest = max(largest, float(np.arccos(np.clip(u @ u[0], -1.0, 1.0)).max()))
    if np.isfinite(able.slew_limit) and largest > 0.0:
        planned = able.time(largest)
        yield CheckRow(
            "slew-limit-authority", "attitude",
            f"time of the largest rotation ({np.rad2deg(largest):.0f} deg) against "
            f"{_MAX_SLEW_TIME_RATIO:g} times its time at the slew limit",
            planned, _MAX_SLEW_TIME_RATIO * largest / able.slew_limit, "s",
            "Otherwise the torque, not the slew limit, sets the time of rotations, and guidance "
            f"underestimates it: raise {keys}, or lower control.slew_limit_deg_s.",
        )  # fmt: skip
    if isinstance(control, QuaternionFeedback):
        yield CheckRow(
            "control-braking", "attitude",
            "angular acceleration that the control assumes for stopping",
            float(np.rad2deg(able.start)), float(np.rad2deg(control.braking)), "deg/s^2",
            "Otherwise rotations overshoot: lower control.braking_rad_s2, or raise "
            f"{keys}.", "at most",
        )  # fmt: skip
    yield from _bandwidth_rows(able, control, keys)


def _bandwidth_rows(able: Agility, control: Any, keys: str) -> Iterator[CheckRow]:
    """Yield the checks of the bandwidth of a linear attitude loop.

    The loop ``rate = f / (2 z) error`` commands the slew limit w down to the error ``2 z w / f``.
    The lander can stop in this angle without overshoot if ``w^2 / (2 alpha)`` is less, so that
    ``f <= 4 z alpha / w`` with the angular acceleration alpha. The loader of scenarios checks the
    frequency against the period of thruster commands.
    """
    frequency, damping = getattr(control, "frequency", None), getattr(control, "damping", None)
    if not (isinstance(frequency, float) and isinstance(damping, float)):
        return
    if not isinstance(control, QuaternionFeedback) and np.isfinite(able.slew_limit):
        yield CheckRow(
            "control-bandwidth", "attitude", "natural frequency of the attitude loop",
            4.0 * damping * able.start / able.slew_limit, frequency, "rad/s",
            "Otherwise the torque saturates and every rotation overshoots: lower "
            f"control.frequency_rad_s or control.slew_limit_deg_s, or raise {keys}.", "at most",
            wanted_margin=0.1,
        )  # fmt: skip
