"""Nominal descent of a scenario: approach path and terminal descent, not flown.

The approach is the planned path of the guidance law from the planned start, in closed form. The
terminal descent integrates the commands of its law for a point mass that follows every command at
once. Neither has noise, lag, rotation or throttle limits: these are what the checks compare.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import PathLimits
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.guidance.vertical import TerminalDescentLaw
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.phases import initial_time_to_go
from lunarsim.typing import Array

# Number of intervals along the approach path.
_INTERVALS = 400
# Maximum duration of the terminal descent, s: a descent of 10 m at 0.05 m/s.
_MAX_TERMINAL_S = 200.0
# Mass share that counts as dry, and factor on the maximum thrust, where propellant and thrust do
# not limit a path.
_DRY_SHARE, _THRUST_FACTOR = 0.3, 4.0
_SITE = np.zeros(3)
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class DescentPath:
    """Samples of a descent phase over the site at the origin, ENU.

    Attributes
    ----------
    time
        Time since the start of the phase (n,), s.
    position, velocity
        Centre of mass (n, 3), m and m/s.
    acceleration
        Commanded thrust acceleration (n, 3), m/s^2, gravity compensated.
    mass
        Mass (n,), kg.
    com_height
        Height of the centre of mass above the pads, m.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    mass: Array
    com_height: float

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
        return np.asarray(np.where(size > 0.0, self.acceleration / np.maximum(size, 1e-12), _UP))

    @property
    def duration(self) -> float:
        """Duration of the phase, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def propellant(self) -> float:
        """Propellant that the phase uses, kg."""
        return float(self.mass[0] - self.mass[-1])

    def index_at(self, altitude: float) -> int:
        """Return the index of the first sample at or below an altitude (m).

        It is the last index if the phase ends above the altitude.
        """
        below = np.flatnonzero(self.altitude <= altitude)
        return int(below[0]) if below.size else len(self.time) - 1

    def estimate(self, index: int) -> Estimate:
        """Return the state at a sample as an estimate with zero covariance."""
        return as_estimate(self.position[index], self.velocity[index], float(self.mass[index]))


@dataclass(frozen=True)
class PlannedApproach:
    """Planned approach to the target, and the limits that no path to it keeps.

    Attributes
    ----------
    path
        Path until the terminal descent begins.
    time_to_go
        Planned duration at the start, s.
    exceeds
        Limits that had to be ignored to find a path, in this order: "propellant", "thrust",
        "tilt and glideslope", "time". Empty if a path keeps all limits.
    """

    path: DescentPath
    time_to_go: float
    exceeds: tuple[str, ...]


def as_estimate(position: Array, velocity: Array, mass: float) -> Estimate:
    """Return position (3,), m, velocity (3,), m/s, and mass (kg) as an estimate."""
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    r, v = (np.asarray(x, dtype=np.float64) for x in (position, velocity))
    return Estimate(0.0, r, v, upright, np.zeros(3), mass, np.zeros((9, 9)))


def path_shape(law: Any) -> PathShape:
    """Return the shape of a guidance law's paths; Apollo's for a law without one."""
    shape = getattr(law, "shape", None)
    return shape if isinstance(shape, PathShape) else APOLLO


def mass_along(acceleration: Array, time: Array, mass: float, exhaust_velocity: float) -> Array:
    """Return the mass (n,), kg, along a thrust history, by the rocket equation.

    ``m = m0 exp(-dv / v_e)``, where dv is the integral of the thrust acceleration by the
    trapezoidal rule. `acceleration` is (n, 3), m/s^2, `time` (n,), s, and `exhaust_velocity` m/s.
    """
    size = np.linalg.norm(acceleration, axis=1)
    dv = np.concatenate(([0.0], np.cumsum(0.5 * (size[1:] + size[:-1]) * np.diff(time))))
    return np.asarray(mass * np.exp(-dv / exhaust_velocity))


def sampled_path(
    shape: PathShape, start: Estimate, end: PhaseEnd, time_to_go: float, lander: Lander,
    gravity: float,
) -> DescentPath:  # fmt: skip
    """Return samples of a guidance law's path to the end of the approach.

    `time_to_go` is in s and `gravity` in m/s^2.
    """
    planned = shape.path(start.position, start.velocity, end, time_to_go)
    time = np.linspace(0.0, time_to_go, _INTERVALS + 1)
    position, velocity, acceleration = planned.at(time)
    thrust = acceleration + gravity * _UP
    mass = mass_along(thrust, time, start.mass, lander.exhaust_velocity)
    return DescentPath(time, position, velocity, thrust, mass, lander.com_height)


def unlimited_lander(lander: Lander, *, thrust: bool = False) -> Lander:
    """Return a lander of equal mass whose propellant does not limit a path.

    With `thrust`, its thrust range does not limit a path either.
    """
    dry = _DRY_SHARE * lander.wet_mass
    return Lander(
        dry_mass=dry, propellant_mass=lander.wet_mass - dry,
        thrust_min=0.0 if thrust else lander.thrust_min,
        thrust_max=_THRUST_FACTOR * lander.thrust_max if thrust else lander.thrust_max,
        specific_impulse=lander.specific_impulse, com_height=lander.com_height,
    )  # fmt: skip


def without_angles(limits: PathLimits) -> PathLimits:
    """Return path limits without limits of tilt, glideslope and reserve."""
    return replace(
        limits, max_tilt=float(np.deg2rad(84.0)), glideslope=0.0, reserve=0.0, throttle_margin=0.0
    )


def plan_approach(
    law: Any, approach: Approach, start: Estimate, lander: Lander, gravity: float
) -> PlannedApproach:
    """Plan the approach from a start state to the target at the origin.

    The time-to-go is that of a flight: fixed by the settings, from the jerk, or the one with
    minimum propellant within the limits. If no path keeps the limits, they are ignored one after
    another. `gravity` is in m/s^2.
    """
    end = approach.end(_SITE, lander)
    time_to_go, exceeds = _planned_time(law, approach, start, lander, gravity)
    full = sampled_path(path_shape(law), start, end, time_to_go, lander, gravity)
    left = time_to_go - full.time
    over = [
        i for i in range(len(left))
        if i and approach.is_finished(float(full.altitude[i]), float(left[i]))
    ]  # fmt: skip
    last = over[0] if over else len(left) - 1
    kept = slice(last + 1)
    path = replace(
        full, time=full.time[kept], position=full.position[kept], velocity=full.velocity[kept],
        acceleration=full.acceleration[kept], mass=full.mass[kept],
    )  # fmt: skip
    return PlannedApproach(path, time_to_go, exceeds)


def _planned_time(
    law: Any, approach: Approach, start: Estimate, lander: Lander, gravity: float
) -> tuple[float, tuple[str, ...]]:
    """Return the planned time-to-go (s) and the limits that were ignored to find it."""
    ends = approach.end(_SITE[None, :], lander)
    one = approach.end(_SITE, lander)
    if not approach.has_free_time_to_go:
        return initial_time_to_go(approach, start, one, np.inf)[0], ()
    limits = replace(approach.limits, reserve=0.0)
    cases = (
        (lander, approach.limits, ()),
        (unlimited_lander(lander), limits, ("propellant",)),
        (unlimited_lander(lander, thrust=True), limits, ("propellant", "thrust")),
        (
            unlimited_lander(lander, thrust=True), without_angles(limits),
            ("propellant", "thrust", "tilt and glideslope"),
        ),
    )  # fmt: skip
    for vehicle, kept, exceeds in cases:
        found = float(law.cost(start, ends, vehicle, gravity, kept).time_to_go[0])
        if np.isfinite(found):
            return found, exceeds
    return initial_time_to_go(approach, start, one, np.inf)[0], (*cases[-1][2], "time")


def terminal_descent(
    law: TerminalDescentLaw, approach: Approach, start: Estimate, lander: Lander, cycle: float,
    gravity: float,
) -> tuple[DescentPath, bool]:  # fmt: skip
    """Integrate the terminal descent of a point mass; return it and whether it lands.

    The point mass follows each command of the law for one control cycle (s) at once. `start` is
    the state at the end of the approach, and `gravity` is in m/s^2. The descent ends when the
    footpads reach the site, at the latest after 200 s.
    """
    end = approach.touchdown_end(_SITE, lander)
    state, rows = start, []
    for k in range(max(2, int(_MAX_TERMINAL_S / cycle))):
        command = np.asarray(law.command(state, end, k * cycle), dtype=np.float64)
        rows.append((k * cycle, state.position, state.velocity, command, state.mass))
        if state.position[2] <= end.position[2] and k:
            break
        total = command - gravity * _UP
        burnt = float(np.linalg.norm(command)) * cycle / lander.exhaust_velocity
        state = replace(
            state, time=(k + 1) * cycle,
            position=state.position + cycle * (state.velocity + 0.5 * cycle * total),
            velocity=state.velocity + cycle * total, mass=state.mass * float(np.exp(-burnt)),
        )  # fmt: skip
    time, position, velocity, command, mass = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    path = DescentPath(time, position, velocity, command, mass, lander.com_height)
    return path, bool(path.altitude[-1] <= 0.0)
