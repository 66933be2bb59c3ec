"""Reference trajectory for guidance, with interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from lunarsim.errors import InputError
from lunarsim.typing import Array

# Deviation of a position from the integral of the velocities: this fraction of the distance that
# the lander has covered, plus this distance, m. Wrong units and exchanged columns exceed it.
_MAX_DEVIATION_RATIO, _MAX_DEVIATION_M = 0.05, 1.0
# Maximum time of the first state, s: the reference begins with the flight.
_MAX_START_TIME_S = 1e-3


@dataclass(frozen=True)
class ReferenceTrajectory:
    """Trajectory of the lander's centre of mass in the site frame.

    Attributes
    ----------
    time
        Time since the start of the flight (n,), s, strictly increasing, from 0.
    position, velocity
        Positions and velocities (n, 3), m and m/s.

    Raises
    ------
    InputError
        If there are fewer than two states, a value is not finite, the times do not increase or do
        not begin at 0, or positions and velocities contradict each other.
    """

    time: Array
    position: Array
    velocity: Array

    def __post_init__(self) -> None:
        if len(self.time) < 2:
            raise InputError("path", len(self.time), "must contain at least two states")
        for name in ("time", "position", "velocity"):
            values = getattr(self, name).reshape(len(self.time), -1)
            wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
            if len(wrong):
                raise InputError(
                    "path", f"state {wrong[0] + 1}", f"must contain finite numbers, {name} is not"
                )
        wrong = np.flatnonzero(np.diff(self.time) <= 0.0)
        if len(wrong):
            raise InputError(
                "path", f"state {wrong[0] + 2}", "must contain strictly increasing times"
            )
        if abs(self.time[0]) > _MAX_START_TIME_S:
            raise InputError("path", float(self.time[0]), "must begin at the time 0 s")
        self._check_consistency()

    def _check_consistency(self) -> None:
        """Raise InputError unless the positions follow from the velocities."""
        step = np.diff(self.time)[:, None]
        moves = 0.5 * step * (self.velocity[1:] + self.velocity[:-1])
        deviation = np.linalg.norm(
            self.position[1:] - self.position[0] - np.cumsum(moves, axis=0), axis=1
        )
        covered = np.cumsum(np.linalg.norm(np.diff(self.position, axis=0), axis=1))
        wrong = np.flatnonzero(deviation > _MAX_DEVIATION_RATIO * covered + _MAX_DEVIATION_M)
        if len(wrong):
            k = int(wrong[0])
            raise InputError(
                "path", f"state {k + 2}",
                "must contain positions that follow from the velocities, because the integral "
                f"of the velocities differs by {deviation[k]:.3g} m",
                "Check units, columns and spacing of the states.",
            )  # fmt: skip

    @property
    def duration(self) -> float:
        """Time of the last state, s."""
        return float(self.time[-1])

    @cached_property
    def _path(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.time, self.position, self.velocity)

    @cached_property
    def _acceleration(self) -> Array:
        # Second derivatives of the positions would amplify the rounding of a file.
        return np.asarray(np.gradient(self.velocity, self.time, axis=0))

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (3,) at a time, s.

        The acceleration, gravity included, is the linearly interpolated derivative of the
        velocities. Positions are interpolated by cubic Hermite polynomials. Before and after the
        trajectory, the first and the last state hold, without acceleration.
        """
        inside = min(max(time, float(self.time[0])), self.duration)
        position = self._path(inside)
        velocity = np.array([np.interp(inside, self.time, v) for v in self.velocity.T])
        if inside != time:
            return np.asarray(position), velocity, np.zeros(3)
        acceleration = np.array([np.interp(time, self.time, a) for a in self._acceleration.T])
        return np.asarray(position), velocity, acceleration

    def time_at_height(self, height: float) -> float:
        """Return the first time, s, at or below a height, m; without one, the last time."""
        z = self.position[:, 2]
        below = np.flatnonzero(z <= height)
        if not len(below):
            return self.duration
        k = int(below[0])
        if k == 0:
            return float(self.time[0])
        share = (z[k - 1] - height) / (z[k - 1] - z[k])
        return float(self.time[k - 1] + share * (self.time[k] - self.time[k - 1]))
