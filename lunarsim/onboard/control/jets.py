"""Fast attitude loop of a lander with on-off thrusters and a gimballed engine."""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim._frame_kernels import rotation_vector_between
from lunarsim.frames import quat_multiply
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import Command
from lunarsim.models.jet_lander import JetLander
from lunarsim.onboard.component_errors import checked_vector
from lunarsim.onboard.control.allocation import ThrusterAllocation
from lunarsim.onboard.control.contract import AttitudeControl
from lunarsim.onboard.control.loop import AttitudeLoop
from lunarsim.onboard.control.thruster_failure_detector import ThrusterFailureDetector
from lunarsim.typing import Array

# Default time between thruster commands for laws without a `period`, s.
_DEFAULT_PERIOD_S = 0.1
# Time constant with which the gimbal takes over a steady thruster torque, s.
_TRIM_TIME_CONSTANT_S = 4.0


class JetLoop(AttitudeLoop):
    """Attitude loop that fires thrusters and trims steady torques with the gimbal.

    If the centre of mass is off the engine's axis, the initial gimbal angle points the thrust
    through the centre of mass, and the body tilts by the same angle in the opposite direction.

    The torque of a control law is converted into thruster pulses. The remainder that is shorter
    than the shortest pulse is carried into the next period. A law with a method `rate_change`
    commands firings directly.

    Parameters
    ----------
    law, lander, step
        Control law, lander model and gyroscope sample period (s).

    Attributes
    ----------
    on_times, gimbal
        Commands of the current period: on-time of each thruster (n,), s, and gimbal angles (2,),
        rad.
    propellant_used
        Thruster propellant used by the commanded firings, kg.
    failure_detector
        Thruster failure detector; failed thrusters are no longer used.
    """

    def __init__(self, law: AttitudeControl, lander: JetLander, step: float) -> None:
        super().__init__(law, lander, step)
        self.vehicle = lander
        self.allocation = ThrusterAllocation(lander.thrusters)
        self.period_steps = max(1, round(getattr(law, "period", _DEFAULT_PERIOD_S) / step))
        self.on_times = np.zeros(lander.thrusters.count)
        self.gimbal = np.zeros(2)
        self.propellant_used = 0.0
        self._carry = np.zeros(3)
        self._step = 0
        self._thrust = 0.0
        self._arm = lander.engine.pivot_depth
        self.failure_detector = ThrusterFailureDetector(lander.thrusters.count)
        self._com = np.zeros(3)
        self._rate: Array | None = None
        self._impulse = np.zeros(3)
        self._started = False

    @property
    def compiled(self) -> bool:
        """Always False: the compiled attitude loop does not support thrusters."""
        return False

    @property
    def period(self) -> float:
        """Time between thruster commands, s."""
        return self.period_steps * self.step

    @property
    def is_due(self) -> bool:
        """Whether the next call of `torque` computes new thruster commands."""
        return self._step % self.period_steps == 0

    def start_cycle(self, command: Command, attitude: Array, mass: float) -> None:
        """Set commanded attitude, estimated attitude (4,) and mass (kg) for a new cycle."""
        self._com = self.vehicle.com(mass)
        self._arm = self.vehicle.engine.pivot_depth + float(self._com[2])
        super().start_cycle(command, attitude, mass)

    def set_command(self, command: Command) -> None:
        """Set commanded thrust and attitude, also within a cycle.

        The commanded attitude is corrected for an engine that is gimballed through an offset centre
        of mass.
        """
        super().set_command(command)
        self._thrust = command.thrust
        gimbal_angles = self._gimbal_through_com()
        if gimbal_angles.any():
            # The gimballed engine does not push along body z: tilt the body in return.
            self.target = quat_multiply(self.target, _align_thrust(gimbal_angles))
            if not self._started:
                self.gimbal = gimbal_angles
        self._started = True

    def torque(self) -> Array:
        """Return the mean torque of the current firings (3,), N m.

        New firings are computed first if a period has ended.
        """
        if self.is_due:
            self._command_thrusters()
        self._step += 1
        return self.state[7:].copy()

    def _gimbal_through_com(self) -> Array:
        """Return gimbal angles (2,), rad, that point thrust through the centre of mass."""
        east, north = float(self._com[0]), float(self._com[1])
        if self.vehicle.engine.gimbal_limit == 0.0 or self._arm <= 0.0:
            return np.zeros(2)
        gimbal_angles = np.array(
            [-np.arctan2(north, np.hypot(east, self._arm)), np.arctan2(east, self._arm)]
        )
        limit = self.vehicle.engine.gimbal_limit
        return np.asarray(np.clip(gimbal_angles, -limit, limit))

    def _measure_last_period(self) -> None:
        """Trim the gimbal and exclude failed thrusters, from the last rate change.

        The failure detector compares the measured rate change of the period with the commanded
        one. Failed thrusters stay in use if the others cannot produce a torque in every direction.
        """
        rate, before = self.state[4:7].copy(), self._rate
        self._rate = rate
        if before is None:
            return
        jets, period, inertia = self.vehicle.thrusters, self.period, self.inertia
        about_com = jets.torques - np.cross(self._com, jets.forces)
        engine = -self._thrust * self._arm * np.array([*self.gimbal, 0.0]) * period
        (x, y), (east, north, _) = self.gimbal, self._com
        engine += self._thrust * period * np.array([-north, east, east * x + north * y])
        turns = self.on_times[:, None] * about_com / inertia
        if self.failure_detector.update(rate - before, engine / inertia, turns, period):
            left = ThrusterAllocation(jets, self.failure_detector.failed)
            if left.spans_all_torques:
                self.allocation = left
        self._trim_gimbal(self._impulse - self.inertia * (rate - before))

    def _command_thrusters(self) -> None:
        """Compute and store the on-times and gimbal angles of the next period.

        Thrusters that failed in the last period are excluded first. The mean torque of the firings
        is written to `state[7:]`.
        """
        self._measure_last_period()
        error = np.empty(3)
        rotation_vector_between(self.state[:4], self.target, error)
        rate, inertia, period = self.state[4:7].copy(), self.inertia, self.period
        law: Any = self.law
        if hasattr(law, "rate_change"):
            a = self.allocation.authority / inertia
            least = self.allocation.min_impulse / inertia
            change = law.rate_change(error, rate, a, least)
            impulse = inertia * checked_vector("control", law, "rate_change", change, "rad/s")
        else:
            torque = checked_vector(
                "control", law, "torque", law.torque(error, rate, inertia), "N m"
            )
            impulse = torque * period + self._carry
        self.on_times = self.allocation.on_times(impulse / period, period)
        given = self.allocation.impulse(self.on_times)
        if not hasattr(law, "rate_change"):
            most = self.allocation.min_impulse
            self._carry = np.clip(impulse - given, -most, most)
        self.propellant_used += self.vehicle.thrusters.propellant_flow * float(self.on_times.sum())
        self._impulse = given
        self.state[7:] = given / period

    def _trim_gimbal(self, impulse: Array) -> None:
        """Move the gimbal to take over the thruster torque that opposes a disturbance.

        `impulse` (3,), N m s, is the angular impulse of the thrusters in the last period, without
        the part that changed the angular rate. With that part, the gimbal would move during a slew
        and then work against the thrusters that end it.
        """
        engine = self.vehicle.engine
        pull = self._thrust * self._arm
        if engine.gimbal_limit == 0.0 or pull <= 0.0:
            return
        most = engine.gimbal_rate * self.period
        swing = np.clip(-impulse[:2] / (pull * _TRIM_TIME_CONSTANT_S), -most, most)
        self.gimbal = np.clip(self.gimbal + swing, -engine.gimbal_limit, engine.gimbal_limit)


def _align_thrust(gimbal_angles: Array) -> Array:
    """Return the quaternion (4,) that rotates a gimballed engine's thrust onto body z.

    `gimbal_angles` (2,) are the gimbal angles about body x and y, rad.
    """
    x, y = gimbal_angles
    push = np.array([np.sin(y) * np.cos(x), -np.sin(x), np.cos(y) * np.cos(x)])
    turn = np.array([push[1], -push[0], 0.0, 1.0 + push[2]])  # axis push x z, half the angle
    return np.asarray(turn / np.linalg.norm(turn))


def attitude_loop(briefing: Briefing) -> AttitudeLoop:
    """Return the attitude loop of a flight: `JetLoop` if the lander has thrusters.

    All other landers get an `AttitudeLoop`. A control law with a method `build` is built for the
    flight.
    """
    settings, lander = briefing.software.control, briefing.lander
    law = settings.build(briefing) if hasattr(settings, "build") else settings
    loop = JetLoop if isinstance(lander, JetLander) else AttitudeLoop
    return loop(law, lander, briefing.step)  # type: ignore[arg-type]
