"""Nominal approach of a scenario: the planned path of its guidance law, not flown."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.divert_cost import PathLimits
from lunarsim.onboard.guidance.rotation import path_shape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.phases import initial_time_to_go
from lunarsim.typing import Array

# Number of intervals along the approach path.
_INTERVALS = 400
# A lander whose propellant and thrust do not limit a path has this dry share of its mass and this
# factor on its maximum thrust.
_DRY_SHARE, _THRUST_FACTOR = 0.3, 4.0
_SITE = np.zeros(3)
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class ApproachPath:
    """Samples of the planned approach to the site at the origin, ENU.

    Attributes
    ----------
    time
        Time since the start of the approach (n,), s.
    position, velocity
        Centre of mass (n, 3), m and m/s.
    acceleration
        Commanded thrust acceleration (n, 3), m/s^2, gravity compensated.
    mass
        Mass (n,), kg.
    com_height
        Height of the centre of mass above the pads, m.
    time_to_go
        Planned duration until time-to-go is 0, s; the approach may end before.
    is_within_limits
        Whether the path keeps the limits of tilt and glideslope.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    mass: Array
    com_height: float
    time_to_go: float
    is_within_limits: bool

    @property
    def altitude(self) -> Array:
        """Altitude of the footpads above the site (n,), m."""
        return np.asarray(self.position[:, 2] - self.com_height)

    @property
    def thrust(self) -> Array:
        """Commanded thrust (n,), N."""
        return np.asarray(self.mass * np.linalg.norm(self.acceleration, axis=1))

    @property
    def direction(self) -> Array:
        """Unit vectors of the commanded thrust (n, 3), ENU."""
        size = np.linalg.norm(self.acceleration, axis=1, keepdims=True)
        return np.asarray(np.where(size > 0.0, self.acceleration / np.maximum(size, 1e-12), UP))

    def index_at(self, altitude: float) -> int:
        """Return the index of the first sample at or below an altitude (m).

        It is the last index if the approach ends above the altitude.
        """
        return int(np.argmax(np.append(self.altitude[:-1] <= altitude, True)))

    def estimate(self, index: int) -> Estimate:
        """Return the state at a sample as an estimate with zero covariance."""
        return as_estimate(self.position[index], self.velocity[index], float(self.mass[index]))


def as_estimate(position: Array, velocity: Array, mass: float) -> Estimate:
    """Return position (3,), m, velocity (3,), m/s, and mass (kg) as an estimate."""
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    return Estimate(0.0, position, velocity, upright, np.zeros(3), mass, np.zeros((9, 9)))


def unlimited_lander(lander: Lander, *, thrust: bool = False) -> Lander:
    """Return a lander of equal mass whose propellant does not limit a path.

    With `thrust`, its thrust range does not limit a path either.
    """
    dry = _DRY_SHARE * lander.wet_mass
    return Lander(
        dry_mass=dry, propellant_mass=lander.wet_mass - dry,
        thrust_min=0.0 if thrust else lander.thrust_min,
        thrust_max=(_THRUST_FACTOR if thrust else 1.0) * lander.thrust_max,
        specific_impulse=lander.specific_impulse, com_height=lander.com_height,
    )  # fmt: skip


def plan_approach(
    law: Any, approach: Approach, start: Estimate, lander: Lander, gravity: float
) -> ApproachPath:
    """Plan the approach from a start state to the target at the origin.

    The time-to-go is that of a flight: fixed by the settings, from the jerk, or the one with
    minimum propellant within the limits. If no path keeps the limits, those of propellant and then
    those of thrust are ignored. `gravity` is in m/s^2.
    """
    end, ends = approach.end(_SITE, lander), approach.end(_SITE[None, :], lander)
    no_reserve = replace(approach.limits, reserve=0.0)
    free = (
        unlimited_lander(lander, thrust=True),
        replace(no_reserve, throttle_margin=0.0, lower_throttle_margin=None),
    )
    cases = ((lander, approach.limits), (unlimited_lander(lander), no_reserve), free)

    def time_within(vehicle: Lander, limits: PathLimits, times: Array | None = None) -> float:
        return float(law.cost(start, ends, vehicle, gravity, limits, times).time_to_go[0])

    optimal = next((t for case in cases if np.isfinite(t := time_within(*case))), np.inf)
    total, _ = initial_time_to_go(approach, start, end, optimal)
    time = np.linspace(0.0, total, _INTERVALS + 1)
    r, v, a = path_shape(law).path(start.position, start.velocity, end, total).at(time)
    thrust = a + gravity * UP
    mass = _mass_along(thrust, time, start.mass, lander.exhaust_velocity)
    is_over = [
        approach.is_finished(z - lander.com_height, total - t)
        for z, t in zip(r[:, 2], time, strict=True)
    ]
    n = int(np.argmax(np.append(is_over[:-1], True))) + 1
    return ApproachPath(
        time[:n], r[:n], v[:n], thrust[:n], mass[:n], lander.com_height, total,
        bool(np.isfinite(time_within(*free, np.array([total])))),
    )  # fmt: skip


def _mass_along(acceleration: Array, time: Array, mass: float, exhaust_velocity: float) -> Array:
    """Return the mass (n,), kg, along a thrust history, by the rocket equation.

    ``m = m0 exp(-dv / v_e)``, where dv is the integral of the thrust acceleration by the
    trapezoidal rule. `acceleration` is (n, 3), m/s^2, `time` (n,), s, and `exhaust_velocity` m/s.
    """
    size = np.linalg.norm(acceleration, axis=1)
    dv = np.concatenate(([0.0], np.cumsum(0.5 * (size[1:] + size[:-1]) * np.diff(time))))
    return np.asarray(mass * np.exp(-dv / exhaust_velocity))
