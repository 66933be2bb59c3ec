"""Attitude control: a proportional-derivative law, and an ideal actuator that needs none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProportionalDerivative:
    """Quaternion proportional-derivative torques, on gyroscopes.

    Attributes
    ----------
    frequency, damping
        Natural frequency (rad/s) and damping ratio of the loop.
    slew_limit
        Greatest rate asked for about each axis, rad/s.
    """

    frequency: float = quantity(4.0, "rad/s", gt=0, help="natural frequency of the loop")
    damping: float = quantity(0.9, ge=0.3, le=3, help="damping ratio of the loop")
    slew_limit: float = quantity(15.0, "deg/s", gt=0, help="greatest rate asked for")

    torques: ClassVar[bool] = True

    @property
    def response_time(self) -> float:
        """Lag with which the attitude follows a slowly changing command, s."""
        return 2.0 * self.damping / self.frequency

    @property
    def gains(self) -> Array:
        """Frequency, damping and slew limit, as the compiled loop takes them (3,)."""
        return np.array([self.frequency, self.damping, self.slew_limit])

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return the wanted torque (3,), body axes, N m."""
        wanted = np.clip(
            self.frequency / (2.0 * self.damping) * error, -self.slew_limit, self.slew_limit
        )
        return np.asarray(inertia * 2.0 * self.damping * self.frequency * (wanted - rate))


@dataclass(frozen=True)
class IdealAttitude:
    """The attitude follows the command along the shortest arc (section IV.A.3, shadow EKF paper).

    Attributes
    ----------
    slew_limit
        Greatest rate, rad/s.
    """

    slew_limit: float = quantity(15.0, "deg/s", gt=0, help="greatest rate")

    torques: ClassVar[bool] = False

    @property
    def response_time(self) -> float:
        """No lag."""
        return 0.0

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return no torque: the actuator turns the vehicle itself."""
        return np.zeros(3)
