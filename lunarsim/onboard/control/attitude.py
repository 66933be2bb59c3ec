"""Attitude control laws: proportional-derivative, and an ideal attitude actuator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


@dataclass(frozen=True)
class ProportionalDerivative:
    """Proportional-derivative attitude control on the quaternion error and gyro rate.

    Attributes
    ----------
    frequency, damping
        Natural frequency (rad/s) and damping ratio of the closed attitude loop.
    slew_limit
        Maximum commanded rate about each axis, rad/s.
    """

    frequency: float = quantity(4.0, "rad/s", gt=0, help="natural frequency of the attitude loop")
    damping: float = quantity(0.9, ge=0.3, le=3, help="damping ratio of the attitude loop")
    slew_limit: float = quantity(
        15.0,
        "deg/s",
        gt=0,
        help="maximum angular rate about each body axis that the attitude control commands",
    )

    torques: ClassVar[bool] = True

    @property
    def response_time(self) -> float:
        """Lag of the attitude behind a slowly changing command, s."""
        return 2.0 * self.damping / self.frequency

    @property
    def gains(self) -> Array:
        """Gains for the compiled loop (3,): frequency, damping ratio and slew limit."""
        return np.array([self.frequency, self.damping, self.slew_limit])

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return the torque (3,), body axes, N m, for attitude error and angular rate.

        `error` is the rotation vector from the estimated to the commanded attitude (3,), rad;
        `rate` is the measured rate (3,), rad/s; `inertia` are the principal moments (3,), kg m^2.
        """
        wanted = np.clip(
            self.frequency / (2.0 * self.damping) * error, -self.slew_limit, self.slew_limit
        )
        return np.asarray(inertia * 2.0 * self.damping * self.frequency * (wanted - rate))


@dataclass(frozen=True)
class IdealAttitude:
    """Ideal attitude actuator that turns the lander to the commanded attitude.

    It turns on the shortest arc, without lag or torque, at up to `slew_limit` (shadow EKF paper,
    section IV.A.3).

    Attributes
    ----------
    slew_limit
        Maximum rate, rad/s.
    """

    slew_limit: float = quantity(15.0, "deg/s", gt=0, help="maximum angular rate of the lander")

    torques: ClassVar[bool] = False

    @property
    def response_time(self) -> float:
        """Lag of the attitude, s: zero for the ideal actuator."""
        return 0.0

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return zero torque (3,), because the ideal actuator turns the vehicle directly."""
        return np.zeros(3)
