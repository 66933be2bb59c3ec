"""Schedules by altitude and by time, and the sweep of a square."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import SensorTask
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.tasking.contract import Looks, Situation
from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]

_DOWN = np.array([0.0, 0.0, -1.0])


def _check_rate(sensor: str, key: str, rate: float, briefing: Briefing) -> None:
    if rate * briefing.cycle > 1.0 + 1e-9:
        raise InputError(
            f"tasking.{sensor}.{key}",
            rate,
            f"at most {1.0 / briefing.cycle:g}, one measurement a control cycle",
        )


def _next_due(due: float, now: float, interval: float) -> float:
    """Return when to measure again after measuring `now` what was due at `due`, s.

    Cycles later than due are not lost, so that a rate that does not divide that of the cycles is
    kept on the whole; after a pause it begins anew.
    """
    return due + interval if now < due + interval else now + interval


@dataclass(frozen=True)
class AtAltitudes:
    """One measurement at each of some altitudes.

    Attributes
    ----------
    altitudes
        Above the site, m.
    boresight
        "site" or "nadir".
    """

    altitudes: tuple[float, ...] = quantity((350.0, 160.0), "m", gt=0, help="above the site")
    boresight: Literal["site", "nadir"] = quantity("site", help="where it looks")

    def __post_init__(self) -> None:
        if not self.altitudes:
            raise InputError("altitudes", (), "at least one altitude in metres")

    @property
    def looks(self) -> Looks:
        """Where it measures."""
        return Looks(at=self.altitudes)

    def build(self, sensor: str, briefing: Briefing) -> AltitudeSchedule:
        """Return the schedule of one flight."""
        limit = briefing.instruments[sensor].gimbal_limit
        return AltitudeSchedule(sensor, self.altitudes, self.boresight == "site", limit)


@dataclass(frozen=True)
class Periodic:
    """Measurements of the site at a fixed rate below an altitude, down to another.

    Attributes
    ----------
    rate
        Hz.
    first_altitude
        Above the site, m.
    last_altitude
        At and below it nothing is measured: another sensor looks there, m.

    Raises
    ------
    InputError
        If the last altitude is not below the first.
    """

    rate: float = quantity(10.0, "Hz", gt=0, help="measurements a second")
    first_altitude: float = quantity(400.0, "m", gt=0, help="of the first, above the site")
    last_altitude: float = quantity(
        0.0, "m", ge=0, help="above the site; from there on nothing is measured"
    )

    def __post_init__(self) -> None:
        if not self.last_altitude < self.first_altitude:
            raise InputError(
                "last_altitude_m", self.last_altitude,
                f"less than first_altitude_m, {self.first_altitude:g} m",
            )  # fmt: skip

    @property
    def looks(self) -> Looks:
        """Where it measures."""
        return Looks(highest=self.first_altitude, lowest=self.last_altitude)

    def build(self, sensor: str, briefing: Briefing) -> PeriodicSchedule:
        """Return the schedule of one flight."""
        _check_rate(sensor, "rate_hz", self.rate, briefing)
        limit = briefing.instruments[sensor].gimbal_limit
        return PeriodicSchedule(
            sensor, self.rate, self.first_altitude, limit, last_altitude=self.last_altitude
        )


@dataclass(frozen=True)
class Sweep:
    """A square about the site swept row by row, then a dwell on the site.

    Attributes
    ----------
    size
        Side of the square, m.
    duration
        Of the sweep, s.
    rate, dwell_rate
        While it sweeps, and on the site, Hz.
    last_altitude
        Below it the sensor is turned away, m.
    """

    size: float = quantity(90.0, "m", gt=0, help="side of the square")
    duration: float = quantity(20.0, "s", gt=0, help="then it dwells on the site")
    rate: float = quantity(20.0, "Hz", gt=0, help="while it sweeps")
    dwell_rate: float = quantity(5.0, "Hz", gt=0, help="on the site")
    last_altitude: float = quantity(15.0, "m", ge=0, help="below it the sensor is turned away")

    @property
    def looks(self) -> Looks:
        """Where it measures."""
        return Looks(lowest=self.last_altitude)

    def build(self, sensor: str, briefing: Briefing) -> SweepSchedule:
        """Return the schedule of one flight."""
        _check_rate(sensor, "rate_hz", self.rate, briefing)
        _check_rate(sensor, "dwell_rate_hz", self.dwell_rate, briefing)
        return SweepSchedule(
            sensor, size=self.size, duration=self.duration, rate=self.rate,
            dwell_rate=self.dwell_rate, last_altitude=self.last_altitude,
            limit=briefing.instruments[sensor].gimbal_limit,
        )  # fmt: skip


class AltitudeSchedule:
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


class PeriodicSchedule:
    """Measurements of the site at a fixed rate below an altitude, down to another.

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
    last_altitude
        At and below it nothing is measured, m.
    """

    def __init__(
        self,
        sensor: str,
        rate: float,
        first_altitude: float,
        limit: float,
        *,
        last_altitude: float = 0.0,
    ) -> None:
        self._sensor = sensor
        self._interval = 1.0 / rate
        self._first_altitude, self._last_altitude = first_altitude, last_altitude
        self._limit = limit
        self._next = -np.inf

    def task(self, situation: Situation) -> SensorTask | None:
        """Measure when the next one is due."""
        s = situation
        due = s.time >= self._next - 1e-9
        if not (due and self._last_altitude < s.altitude <= self._first_altitude):
            return None
        self._next = _next_due(self._next, s.time, self._interval)
        mount = gimbal_mount(s.estimate.attitude, s.site - s.estimate.position, self._limit)
        return SensorTask(self._sensor, mount)

    def stop(self) -> None:
        """Measure no more."""
        self._next = np.inf


class SweepSchedule:
    """A square swept row by row, then a dwell on the site.

    Parameters
    ----------
    sensor
        Name of the sensor.
    size
        Side of the square about the site, m.
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
        *,
        size: float,
        duration: float,
        rate: float,
        dwell_rate: float,
        last_altitude: float,
        limit: float,
    ) -> None:
        self._sensor = sensor
        self._size = size
        self._duration = duration
        self._rate, self._dwell_rate = rate, dwell_rate
        self._last_altitude = last_altitude
        self._limit = limit
        self._next = -np.inf
        self._count = 0

    def task(self, situation: Situation) -> SensorTask | None:
        """Measure when the next one is due."""
        s = situation
        if s.time < self._next - 1e-9 or not s.altitude > self._last_altitude:
            return None
        sweeping = s.time < self._duration
        interval = 1.0 / (self._rate if sweeping else self._dwell_rate)
        self._next = _next_due(self._next, s.time, interval)
        aim = s.site + self._offset() if sweeping else s.site
        self._count += 1
        mount = gimbal_mount(s.estimate.attitude, aim - s.estimate.position, self._limit)
        return SensorTask(self._sensor, mount)

    def _offset(self) -> Array:
        """Return where to look at next from the middle of the square (3,), m."""
        rows = max(2, round(np.sqrt(self._duration * self._rate)))
        row, col = divmod(self._count, rows)
        # There and back, like an ox that ploughs; over again if measurements are left.
        row %= rows
        col = col if row % 2 == 0 else rows - 1 - col
        step = self._size / (rows - 1)
        corner = 0.5 * self._size * np.array([1.0, 1.0, 0.0])
        return np.array([row * step, col * step, 0.0]) - corner

    def stop(self) -> None:
        """Measure no more."""
        self._next = np.inf
