"""Navigation by instruments: an inertial unit, and what else the filter takes."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_conjugate, quat_multiply, quat_rotate, quat_to_rotation_vector
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.sensors.altimeter import RadarAltimeter
from lunarsim.sensors.imu import Imu
from lunarsim.vehicle.state import State
from lunarsim.world import World

Array = NDArray[np.float64]


class InertialFilter(Protocol):
    """A filter that inertial samples carry."""

    def propagate(self, angle: Array, velocity: Array) -> None:
        """Carry the filter over samples (n, 3)."""
        ...

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the lander's state."""
        ...


class FilteredNavigation:
    """Feeds a filter with what the lander's instruments measure.

    Parameters
    ----------
    filter
        A `RockFilter`, to which the shadow mapper adds what the camera sees, or a
        `LidarInertialFilter`, to which scans are given.
    world
        What the altimeter measures.
    imu
        The inertial unit.
    altimeter
        Of a `RockFilter`; left out: none.
    rng
        Source of the altimeter's noise.
    """

    def __init__(
        self,
        filter: InertialFilter,
        world: World,
        imu: Imu,
        *,
        altimeter: RadarAltimeter | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        self.filter = filter
        self._world = world
        self._imu = imu
        self._altimeter = altimeter
        self._rng = rng
        self._time: float | None = None

    def sense(self, before: State, history: Array, step: float) -> None:
        """Take in the inertial samples of a stretch of true motion.

        Parameters
        ----------
        before
            State at its start.
        history
            State vectors after each step (n, 15).
        step
            Between them, s; that of the inertial unit.
        """
        rows = np.vstack((before.as_vector(), history))
        q = rows[:, 6:10]
        turn = quat_to_rotation_vector(quat_multiply(quat_conjugate(q[:-1]), q[1:]))
        middle = q[:-1] + np.where((q[:-1] * q[1:]).sum(1) < 0.0, -1.0, 1.0)[:, None] * q[1:]
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        force = np.diff(rows[:, 3:6], axis=0) / step + [0.0, 0.0, self._world.gravity]
        angle, velocity = self._imu.measure(turn / step, quat_rotate(quat_conjugate(middle), force))
        self.filter.propagate(angle, velocity)

    def update(self, state: State, time: float) -> Estimate:
        """Take one altimeter reading, if there is an altimeter, and return the estimate."""
        if self._altimeter is not None and (self._time is None or time > self._time):
            assert self._rng is not None and isinstance(self.filter, RockFilter)
            reading = self._altimeter.measure(self._world, state, time, self._rng)
            self.filter.update_range(reading.range, reading.sigma, self._altimeter.boresight)
            self._time = time
        return self.filter.estimate(time, state.mass)
