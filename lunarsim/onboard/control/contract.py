"""Interface of attitude control laws."""

from __future__ import annotations

from typing import ClassVar, Protocol

from lunarsim.typing import Array


class AttitudeControl(Protocol):
    """Interface of attitude control laws: attitude error in, torque out.

    The law is evaluated at the sample rate of the gyroscopes.

    Attributes
    ----------
    torques
        Whether the law commands torques. If not, the vehicle must have an ideal attitude actuator,
        and only the law's `slew_limit` (rad/s) is used.
    """

    torques: ClassVar[bool]

    @property
    def response_time(self) -> float:
        """Lag of the attitude behind a slowly changing command, s."""
        ...

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return the commanded torque (3,), body axes, N m; the loop applies the limits.

        Parameters
        ----------
        error
            Rotation vector from the estimated to the commanded attitude (3,), body axes, rad.
        rate
            Angular rate measured by the gyroscopes (3,), rad/s.
        inertia
            Principal moments at the estimated mass (3,), kg m^2.
        """
        ...
