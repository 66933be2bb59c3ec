"""Schedules by altitude and by time, and the sweep of a square."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.commands import SensorTask
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.tasking.contract import Situation

Array = NDArray[np.float64]

_DOWN = np.array([0.0, 0.0, -1.0])


class AtAltitudes:
    """One measurement at each of some altitudes, of the site or straight down.

    Parameters
    ----------
    sensor
        Name of the sensor.
    altitudes
        Above the site, m.
    at_site
        Whether it looks at the site, else straight down.
    limit
        See `gimbal_mount`, rad.
    """

    def __init__(
        self, sensor: str, altitudes: tuple[float, ...], at_site: bool, limit: float
    ) -> None:
        self._sensor = sensor
        self._pending = sorted(altitudes, reverse=True)
        self._at_site = at_site
        self._limit = limit

    def task(self, situation: Situation) -> SensorTask | None:
        """Measure when an altitude is passed."""
        if not self._pending or situation.altitude > self._pending[0]:
            return None
        while self._pending and situation.altitude <= self._pending[0]:
            self._pending.pop(0)
        to_site = situation.site - situation.estimate.position
        boresight = to_site if self._at_site else _DOWN
        mount = gimbal_mount(situation.estimate.attitude, boresight, self._limit)
        return SensorTask(self._sensor, mount)

    def stop(self) -> None:
        """Measure no more."""
        self._pending.clear()


class Periodic:
    """Measurements of the site at a fixed rate below an altitude.

    Parameters
    ----------
    sensor
        Name of the sensor.
    rate
        Hz.
    first_altitude
        Above the site, m.
    limit
        See `gimbal_mount`, rad.
    """

    def __init__(self, sensor: str, rate: float, first_altitude: float, limit: float) -> None:
        self._sensor = sensor
        self._interval = 1.0 / rate
        self._first_altitude = first_altitude
        self._limit = limit
        self._next = 0.0

    def task(self, situation: Situation) -> SensorTask | None:
        """Measure when the next one is due."""
        s = situation
        if s.time < self._next - 1e-9 or not 0.0 < s.altitude <= self._first_altitude:
            return None
        self._next = s.time + self._interval
        mount = gimbal_mount(s.estimate.attitude, s.site - s.estimate.position, self._limit)
        return SensorTask(self._sensor, mount)

    def stop(self) -> None:
        """Measure no more."""
        self._next = np.inf


class Sweep:
    """A square swept row by row, then a dwell on the site.

    Parameters
    ----------
    sensor
        Name of the sensor.
    centre
        Of the square (3,), m.
    size
        Side of the square, m.
    duration
        Of the sweep, s.
    rate, dwell_rate
        Measurements a second while it sweeps, and on the site, Hz.
    last_altitude
        Below it nothing is measured, m.
    limit
        See `gimbal_mount`, rad.
    """

    def __init__(
        self,
        sensor: str,
        centre: Array,
        *,
        size: float,
        duration: float,
        rate: float,
        dwell_rate: float,
        last_altitude: float,
        limit: float,
    ) -> None:
        self._sensor = sensor
        self._centre = centre.copy()
        self._size = size
        self._duration = duration
        self._rate, self._dwell_rate = rate, dwell_rate
        self._last_altitude = last_altitude
        self._limit = limit
        self._next = 0.0
        self._count = 0

    def task(self, situation: Situation) -> SensorTask | None:
        """Measure when the next one is due."""
        s = situation
        if s.time < self._next - 1e-9 or not s.altitude > self._last_altitude:
            return None
        sweeping = s.time < self._duration
        self._next = s.time + 1.0 / (self._rate if sweeping else self._dwell_rate)
        aim = self._spot() if sweeping else s.site
        self._count += 1
        mount = gimbal_mount(s.estimate.attitude, aim - s.estimate.position, self._limit)
        return SensorTask(self._sensor, mount)

    def _spot(self) -> Array:
        """Return the point of the square to look at next (3,), m."""
        rows = max(2, round(np.sqrt(self._duration * self._rate)))
        row, col = divmod(self._count, rows)
        # There and back, like an ox that ploughs; over again if measurements are left.
        row %= rows
        col = col if row % 2 == 0 else rows - 1 - col
        step = self._size / (rows - 1)
        offset = np.array([row * step, col * step, 0.0]) - 0.5 * self._size * np.array([1, 1, 0])
        return np.asarray(self._centre + offset)

    def stop(self) -> None:
        """Measure no more."""
        self._next = np.inf
