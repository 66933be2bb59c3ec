"""Quaternion feedback about the eigenaxis, with limits on rate and torque.

Wie and Lu, "Feedback control logic for spacecraft eigenaxis rotations under slew rate and control
constraints", Journal of Guidance, Control, and Dynamics 18(6), 1995.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


@dataclass(frozen=True)
class QuaternionFeedback:
    """Eigenaxis quaternion feedback control, limited in angular rate.

    The commanded rate points along the rotation vector of the attitude error. Its magnitude is the
    minimum of the linear feedback, the slew limit, and the rate from which `braking` can still stop
    the rotation. Because the magnitude is limited and not the components, large rotations stay
    about one axis. The torque includes gyroscopic compensation. Small errors follow ``e'' + 2
    damping frequency e' + frequency^2 e = 0``.

    Attributes
    ----------
    frequency, damping
        Natural frequency (rad/s) and damping ratio of the closed attitude loop.
    slew_limit
        Maximum commanded rate, rad/s.
    braking
        Angular acceleration assumed available to stop a rotation, rad/s^2.
    period
        Time between thruster commands, s.
    """

    frequency: float = quantity(2.0, "rad/s", gt=0, help="natural frequency of the attitude loop")
    damping: float = quantity(0.9, ge=0.3, le=3, help="damping ratio of the attitude loop")
    slew_limit: float = quantity(
        10.0, "deg/s", gt=0, help="maximum angular rate that the attitude control commands"
    )
    braking: float = quantity(
        0.08,
        "rad/s^2",
        gt=0,
        help="angular acceleration that the control law assumes is available to stop a rotation",
    )
    period: float = quantity(0.1, "s", gt=0, le=1, help="time between thruster commands")

    torques: ClassVar[bool] = True

    @property
    def response_time(self) -> float:
        """Lag of the attitude behind a slowly changing command, s."""
        return 2.0 * self.damping / self.frequency

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return the torque (3,), body axes, N m, for attitude error and angular rate.

        `error` is the rotation vector from the estimated to the commanded attitude (3,), rad;
        `rate` is the measured rate (3,), rad/s; `inertia` are the principal moments (3,), kg m^2.
        """
        size = float(np.linalg.norm(error))
        wanted = self.frequency / (2.0 * self.damping) * error
        max_rate = min(self.slew_limit, np.sqrt(2.0 * self.braking * size))
        commanded = float(np.linalg.norm(wanted))
        if commanded > max_rate:
            wanted = wanted * (max_rate / commanded)
        gyroscopic = np.cross(rate, inertia * rate)
        return np.asarray(
            inertia * 2.0 * self.damping * self.frequency * (wanted - rate) + gyroscopic
        )
