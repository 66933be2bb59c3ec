"""Phase-plane logic for on-off thrusters.

Angle and rate about each axis define a point in the phase plane. Inside the dead band the vehicle
coasts. A point that would leave the band, or lies outside and does not return fast enough, causes
one firing that corrects the rate (as TJETLAW of the lunar module's autopilot does, Luminary 099).

Without disturbance the limit cycle moves between the edges of the dead band at d/2, half of the
rate change d of the shortest pulse; its period is 8 DB / d. Under a steady angular acceleration a
it bounces on one edge: period d / a, amplitude d^2 / (8 a).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


@dataclass(frozen=True)
class PhasePlane:
    """Phase-plane control law for on-off thrusters, evaluated for each axis.

    The law consists of a dead band in angle and rate, and a switching parabola. Firings are not
    shorter than the shortest pulse.

    Attributes
    ----------
    dead_band
        Attitude error within which the vehicle coasts, rad.
    rate_band
        Rate above which the law brakes even within the dead band, rad/s.
    slew_limit
        Maximum rate of a slew, rad/s.
    period
        Time between evaluations of the law, s.
    """

    dead_band: float = quantity(
        0.3,
        "deg",
        gt=0,
        help="attitude error about an axis below which no thruster fires (dead band)",
    )
    rate_band: float = quantity(
        0.5,
        "deg/s",
        gt=0,
        help="maximum angular rate about an axis at which no thruster fires within the dead band",
    )
    slew_limit: float = quantity(
        10.0,
        "deg/s",
        gt=0,
        help="maximum angular rate of a rotation to a new attitude, about each axis",
    )
    period: float = quantity(0.1, "s", gt=0, le=1, help="time between thruster commands")

    torques: ClassVar[bool] = True

    @property
    def response_time(self) -> float:
        """Lag of the attitude behind a slowly changing command, s.

        The law acts when the angle leaves the dead band. The lag is the time to cross half of the
        band at `rate_band`, at most 1 s.
        """
        return min(self.dead_band / self.rate_band, 1.0)

    def turning_time(self, angle: float) -> float:
        """Return the time of a slew by an angle (rad) at the maximum rate, s.

        A guidance loop that oscillates faster than this time saturates the attitude loop and
        becomes unstable.
        """
        return angle / self.slew_limit

    def rate_change(self, error: Array, rate: Array, authority: Array, min_change: Array) -> Array:
        """Return the rate change that the thrusters must produce about each axis (3,).

        The rate change is in rad/s, and 0 for an axis on which no firing is needed.

        Parameters
        ----------
        error
            Rotation vector from the estimated to the commanded attitude (3,), body axes, rad.
        rate
            Angular rate measured by the gyroscopes (3,), rad/s.
        authority
            Maximum sustained angular acceleration by the thrusters (3,), rad/s^2.
        min_change
            Rate change of the shortest pulse (3,), rad/s.
        """
        return np.array(
            [
                self._axis_rate_change(-float(e), *map(float, rest))
                for e, *rest in zip(error, rate, authority, min_change, strict=True)
            ]
        )

    def _axis_rate_change(
        self, angle: float, rate: float, max_acceleration: float, min_change: float
    ) -> float:
        """Return the commanded rate change about one axis, rad/s.

        `angle` (rad) is the estimated minus the commanded attitude, `rate` (rad/s) the angular
        rate, `max_acceleration` (rad/s^2) the maximum angular acceleration, and `min_change`
        (rad/s) the rate change of the shortest pulse.
        """
        if angle < 0.0 or (angle == 0.0 and rate < 0.0):
            return -self._axis_rate_change(-angle, -rate, max_acceleration, min_change)
        band = self.dead_band
        stopping_angle = angle + rate * abs(rate) / (2.0 * max_acceleration)
        if angle <= band:
            if rate > 0.0 and stopping_angle > band and rate > 0.5 * min_change:
                return -max(
                    rate + 0.5 * min_change, min_change
                )  # the point leaves the band: reverse the rate
            if abs(rate) > self.rate_band:
                return -float(np.sign(rate)) * max(abs(rate) - 0.5 * min_change, min_change)
            return 0.0
        # Plan with half of the authority, to allow for model errors. Just outside the band one
        # shortest pulse suffices.
        return_rate = min(
            self.slew_limit, float(np.sqrt(max_acceleration * max(angle - 1.25 * band, 0.0)))
        )
        if rate > -max(return_rate, 0.1 * min_change):
            return -max(rate + return_rate + 0.5 * min_change, min_change)
        if -rate > return_rate + self.rate_band:
            return max(-rate - return_rate - 0.5 * min_change, min_change)
        return 0.0

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return zero torque (3,), because `rate_change` commands the firings instead."""
        return np.zeros(3)
