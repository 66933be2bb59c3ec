"""The contract of attitude control."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class AttitudeControl(Protocol):
    """A law that turns an attitude error into torques, at the rate of the gyroscopes.

    Attributes
    ----------
    torques
        Whether it commands torques on gyroscopes; else the vehicle is asked to have an ideal
        attitude actuator, and `slew_limit` (rad/s) is all that is used of the part.
    """

    torques: ClassVar[bool]

    @property
    def response_time(self) -> float:
        """Lag with which the attitude follows a slowly changing command, s."""
        ...

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return the wanted torque (3,), body axes, N m; it is cut to the thrusters' range.

        Parameters
        ----------
        error
            Rotation vector from the estimated to the wanted attitude (3,), body axes, rad.
        rate
            Of the gyroscopes (3,), rad/s.
        inertia
            Principal moments at the estimated mass (3,), kg m^2.
        """
        ...
