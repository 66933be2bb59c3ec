"""Phase-plane logic for on-off thrusters.

Angle and rate about each axis are a point in a plane. Inside a dead band the vehicle coasts; a
point that would leave it, or is outside and does not come back fast enough, asks for one firing
that puts the rate right (as TJETLAW of the lunar module's autopilot does, Luminary 099).

Without disturbance the limit cycle goes from one edge of the dead band to the other at half the
rate that the shortest pulse changes, d/2: its period is 8 DB / d. Under a steady angular
acceleration a it bounces on one edge: period d / a, swing d^2 / (8 a).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PhasePlane:
    """On-off thrusters by dead band, switching parabola and shortest pulse, axis by axis.

    Attributes
    ----------
    dead_band
        Angle within which it coasts, rad.
    rate_band
        Rate above which it brakes even within the dead band, rad/s.
    slew_limit
        Greatest rate of a turn, rad/s.
    period
        Between looks at angle and rate, s.
    """

    dead_band: float = quantity(0.3, "deg", gt=0, help="angle within which it coasts")
    rate_band: float = quantity(0.5, "deg/s", gt=0, help="rate that is left alone in the dead band")
    slew_limit: float = quantity(10.0, "deg/s", gt=0, help="greatest rate of a turn")
    period: float = quantity(0.1, "s", gt=0, le=1, help="between looks at angle and rate")

    torques: ClassVar[bool] = True

    @property
    def response_time(self) -> float:
        """Lag with which the attitude follows a slowly changing command, s.

        It acts when the angle leaves the dead band; counted is the time that the band takes at
        the rate that it leaves alone, at most 1 s.
        """
        return min(self.dead_band / self.rate_band, 1.0)

    def turning_time(self, angle: float) -> float:
        """Return how long a turn by an angle (rad) takes at the greatest rate, s.

        A position loop that leans to and fro faster than this has the attitude saturated, and
        swings itself up.
        """
        return angle / self.slew_limit

    def rate_change(self, error: Array, rate: Array, authority: Array, least: Array) -> Array:
        """Return by how much the rate is to be changed about each axis now (3,), rad/s.

        Parameters
        ----------
        error
            Rotation vector from the estimated to the wanted attitude (3,), body axes, rad.
        rate
            Of the gyroscopes (3,), rad/s.
        authority
            Angular acceleration that can be held (3,), rad/s^2.
        least
            Rate change of the shortest pulse (3,), rad/s.
        """
        return np.array(
            [
                self._axis(-float(e), *map(float, rest))
                for e, *rest in zip(error, rate, authority, least, strict=True)
            ]
        )

    def _axis(self, angle: float, rate: float, a: float, least: float) -> float:
        """Return the rate change about one axis; `angle` is how far it is off."""
        if angle < 0.0 or (angle == 0.0 and rate < 0.0):
            return -self._axis(-angle, -rate, a, least)
        band = self.dead_band
        stop = angle + rate * abs(rate) / (2.0 * a)
        if angle <= band:
            if rate > 0.0 and stop > band and rate > 0.5 * least:
                return -max(rate + 0.5 * least, least)  # it leaves the band: turn it round
            if abs(rate) > self.rate_band:
                return -float(np.sign(rate)) * max(abs(rate) - 0.5 * least, least)
            return 0.0
        # Half of the acceleration is kept back for what is not known. Just outside the band one
        # shortest pulse is enough.
        back = min(self.slew_limit, float(np.sqrt(a * max(angle - 1.25 * band, 0.0))))
        if rate > -max(back, 0.1 * least):
            return -max(rate + back + 0.5 * least, least)
        if -rate > back + self.rate_band:
            return max(-rate - back - 0.5 * least, least)
        return 0.0

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return no torque: it orders firings, not torques."""
        return np.zeros(3)
