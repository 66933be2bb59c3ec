"""Quaternion feedback about the eigenaxis, with limits on rate and torque.

Wie and Lu, "Feedback control logic for spacecraft eigenaxis rotations under slew rate and control
constraints", Journal of Guidance, Control, and Dynamics 18(6), 1995.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class QuaternionFeedback:
    """Quaternion feedback: one turn about the eigenaxis, its rate limited, gyroscopic torque out.

    The rate asked for points along the error's rotation vector and is the least of three: what the
    linear loop asks for, the slew limit, and the rate from which `braking` still stops the turn.
    Its size is limited, not its parts, so that a large turn stays about one axis. Small errors see
    ``e'' + 2 damping frequency e' + frequency^2 e = 0``.

    Attributes
    ----------
    frequency, damping
        Natural frequency (rad/s) and damping ratio of the loop.
    slew_limit
        Greatest rate asked for, rad/s.
    braking
        Angular acceleration that may be counted on to stop a turn, rad/s^2.
    period
        Between new orders to thrusters, s.
    """

    frequency: float = quantity(2.0, "rad/s", gt=0, help="natural frequency of the loop")
    damping: float = quantity(0.9, ge=0.3, le=3, help="damping ratio of the loop")
    slew_limit: float = quantity(10.0, "deg/s", gt=0, help="greatest rate asked for")
    braking: float = quantity(0.08, "rad/s^2", gt=0, help="acceleration counted on to stop a turn")
    period: float = quantity(0.1, "s", gt=0, le=1, help="between new orders to thrusters")

    torques: ClassVar[bool] = True

    @property
    def response_time(self) -> float:
        """Lag with which the attitude follows a slowly changing command, s."""
        return 2.0 * self.damping / self.frequency

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return the wanted torque (3,), body axes, N m."""
        size = float(np.linalg.norm(error))
        wanted = self.frequency / (2.0 * self.damping) * error
        most = min(self.slew_limit, np.sqrt(2.0 * self.braking * size))
        asked = float(np.linalg.norm(wanted))
        if asked > most:
            wanted = wanted * (most / asked)
        gyroscopic = np.cross(rate, inertia * rate)
        return np.asarray(
            inertia * 2.0 * self.damping * self.frequency * (wanted - rate) + gyroscopic
        )
