"""Attitude control laws: proportional-derivative, and an ideal attitude actuator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProportionalDerivative:
    """Quaternion proportional-derivative control with gyroscope feedback.

    Attributes
    ----------
    frequency, damping
        Natural frequency (rad/s) and damping ratio of the loop.
    slew_limit
        Maximum commanded rate about each axis, rad/s.
    """

    frequency: float = quantity(4.0, "rad/s", gt=0, help="natural frequency of the loop")
    damping: float = quantity(0.9, ge=0.3, le=3, help="damping ratio of the loop")
    slew_limit: float = quantity(15.0, "deg/s", gt=0, help="maximum commanded rate per axis")

    torques: ClassVar[bool] = True

    @property
    def response_time(self) -> float:
        """Lag of the attitude behind a slowly changing command, s."""
        return 2.0 * self.damping / self.frequency

    @property
    def gains(self) -> Array:
        """Frequency, damping and slew limit for the compiled loop (3,)."""
        return np.array([self.frequency, self.damping, self.slew_limit])

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return the commanded torque (3,), body axes, N m."""
        wanted = np.clip(
            self.frequency / (2.0 * self.damping) * error, -self.slew_limit, self.slew_limit
        )
        return np.asarray(inertia * 2.0 * self.damping * self.frequency * (wanted - rate))


@dataclass(frozen=True)
class IdealAttitude:
    """Ideal actuator on the shortest arc (shadow EKF paper, section IV.A.3).

    Attributes
    ----------
    slew_limit
        Maximum rate, rad/s.
    """

    slew_limit: float = quantity(15.0, "deg/s", gt=0, help="maximum rate")

    torques: ClassVar[bool] = False

    @property
    def response_time(self) -> float:
        """Zero: the ideal actuator has no lag."""
        return 0.0

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return zero torque, because the ideal actuator turns the vehicle directly."""
        return np.zeros(3)
