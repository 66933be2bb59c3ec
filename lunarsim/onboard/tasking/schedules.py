"""Schedules by altitude and by time, and the raster scan of a square."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import SensorTask
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.tasking.contract import MeasurementAltitudes, Situation
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array

_DOWN = np.array([0.0, 0.0, -1.0])


def _check_rate(sensor: str, key: str, rate: float, briefing: Briefing) -> None:
    """Raise InputError if a rate (Hz) exceeds one measurement per control cycle.

    `sensor` and `key` name the scenario key in the error.
    """
    if rate * briefing.cycle > 1.0 + 1e-9:
        raise InputError(
            f"tasking.{sensor}.{key}",
            rate,
            f"must be at most {1.0 / briefing.cycle:g}, one measurement per control cycle "
            f"(simulation.cycle_s = {briefing.cycle:g})",
        )


def _next_due(due: float, now: float, interval: float) -> float:
    """Return the due time of the next measurement, s, after one at the time `now`.

    `due` is the time at which the current measurement was due, and `interval` the time between
    measurements, s. The result is one interval after `due`, so that the mean rate is kept although
    a measurement waits for the end of a cycle. If this time has passed, the result is one interval
    after `now`.
    """
    return due + interval if now < due + interval else now + interval


@dataclass(frozen=True)
class AtAltitudes:
    """Settings of a schedule with one measurement at each of several altitudes.

    Attributes
    ----------
    altitudes
        Altitudes above the site, m.
    boresight
        Direction in which the sensor points: "site" (the landing site) or "nadir" (straight down).
    """

    altitudes: tuple[float, ...] = quantity(
        (350.0, 160.0),
        "m",
        gt=0,
        help="Heights above the site at which the sensor makes one measurement each",
    )
    boresight: Literal["site", "nadir"] = quantity(
        "site",
        help="Direction in which the sensor points: site (to the landing site) or nadir (straight "
        "down)",
    )

    def __post_init__(self) -> None:
        if not self.altitudes:
            raise InputError(
                "altitudes_m", (), "must contain at least one altitude", show_value=False
            )

    @property
    def measurement_altitudes(self) -> MeasurementAltitudes:
        """Altitudes above the site at which the sensor measures."""
        return MeasurementAltitudes(at=self.altitudes)

    def build(self, sensor: str, briefing: Briefing) -> AltitudeSchedule:
        """Return the measurement schedule of one flight for a named sensor."""
        limit = briefing.instruments[sensor].gimbal_limit
        return AltitudeSchedule(sensor, self.altitudes, self.boresight == "site", limit)


@dataclass(frozen=True)
class Periodic:
    """Settings of a schedule that measures the landing site at a fixed rate.

    Attributes
    ----------
    rate
        Measurement rate, Hz.
    first_altitude
        Altitude of the first measurement above the site, m.
    last_altitude
        Altitude above the site at and below which there are no measurements, m.

    Raises
    ------
    InputError
        If the last altitude is not below the first.
    """

    rate: float = quantity(10.0, "Hz", gt=0, help="Measurement rate")
    first_altitude: float = quantity(
        400.0, "m", gt=0, help="Height above the site at which measurements begin"
    )
    last_altitude: float = quantity(
        0.0, "m", ge=0, help="Height above the site at which measurements end"
    )

    def __post_init__(self) -> None:
        if not self.last_altitude < self.first_altitude:
            raise InputError(
                "last_altitude_m", self.last_altitude,
                f"must be less than first_altitude_m, which is {self.first_altitude:g} m",
            )  # fmt: skip

    @property
    def measurement_altitudes(self) -> MeasurementAltitudes:
        """Range of altitudes above the site in which the sensor measures."""
        return MeasurementAltitudes(highest=self.first_altitude, lowest=self.last_altitude)

    def build(self, sensor: str, briefing: Briefing) -> PeriodicSchedule:
        """Return the measurement schedule of one flight for a named sensor."""
        _check_rate(sensor, "rate_hz", self.rate, briefing)
        limit = briefing.instruments[sensor].gimbal_limit
        return PeriodicSchedule(
            sensor, self.rate, self.first_altitude, limit, last_altitude=self.last_altitude
        )


@dataclass(frozen=True)
class Sweep:
    """Settings of a raster scan of a square around the site, then a dwell on the site.

    Attributes
    ----------
    size
        Side of the square, m.
    duration
        Duration of the scan, s.
    rate, dwell_rate
        Measurement rates during the scan and on the site, Hz.
    last_altitude
        Altitude above the site below which there are no measurements, m.
    """

    size: float = quantity(90.0, "m", gt=0, help="Side of the scanned square around the site")
    duration: float = quantity(
        20.0, "s", gt=0, help="Duration of the scan; after it the sensor points at the site"
    )
    rate: float = quantity(20.0, "Hz", gt=0, help="Measurement rate during the scan")
    dwell_rate: float = quantity(
        5.0, "Hz", gt=0, help="Measurement rate after the scan, while the sensor points at the site"
    )
    last_altitude: float = quantity(
        15.0, "m", ge=0, help="Height above the site at which measurements end"
    )

    @property
    def measurement_altitudes(self) -> MeasurementAltitudes:
        """Range of altitudes above the site in which the sensor measures."""
        return MeasurementAltitudes(lowest=self.last_altitude)

    def build(self, sensor: str, briefing: Briefing) -> SweepSchedule:
        """Return the measurement schedule of one flight for a named sensor."""
        _check_rate(sensor, "rate_hz", self.rate, briefing)
        _check_rate(sensor, "dwell_rate_hz", self.dwell_rate, briefing)
        return SweepSchedule(
            sensor, size=self.size, duration=self.duration, rate=self.rate,
            dwell_rate=self.dwell_rate, last_altitude=self.last_altitude,
            gimbal_limit=briefing.instruments[sensor].gimbal_limit,
        )  # fmt: skip


class AltitudeSchedule:
    """Schedule with one measurement at each of several altitudes.

    Parameters
    ----------
    sensor
        Name of the sensor.
    altitudes
        Altitudes above the site, m.
    at_site
        Whether the sensor points at the site instead of straight down.
    gimbal_limit
        Maximum angle of the boresight from body -z, rad.
    """

    def __init__(
        self, sensor: str, altitudes: tuple[float, ...], at_site: bool, gimbal_limit: float
    ) -> None:
        self._sensor = sensor
        self._pending = sorted(altitudes, reverse=True)
        self._at_site = at_site
        self._limit = gimbal_limit

    def task(self, situation: Situation) -> SensorTask | None:
        """Return a measurement task if the lander has passed the next altitude, else None."""
        if not self._pending or situation.altitude > self._pending[0]:
            return None
        while self._pending and situation.altitude <= self._pending[0]:
            self._pending.pop(0)
        to_site = situation.site - situation.estimate.position
        boresight = to_site if self._at_site else _DOWN
        mount = gimbal_mount(situation.estimate.attitude, boresight, self._limit)
        return SensorTask(self._sensor, mount)

    def stop(self) -> None:
        """Stop all further measurements."""
        self._pending.clear()


class PeriodicSchedule:
    """Schedule that measures the landing site at a fixed rate between two altitudes.

    Parameters
    ----------
    sensor
        Name of the sensor.
    rate
        Measurement rate, Hz.
    first_altitude
        Altitude of the first measurement above the site, m.
    gimbal_limit
        Maximum angle of the boresight from body -z, rad.
    last_altitude
        Altitude above the site at and below which there are no measurements, m.
    """

    def __init__(
        self,
        sensor: str,
        rate: float,
        first_altitude: float,
        gimbal_limit: float,
        *,
        last_altitude: float = 0.0,
    ) -> None:
        self._sensor = sensor
        self._interval = 1.0 / rate
        self._first_altitude, self._last_altitude = first_altitude, last_altitude
        self._limit = gimbal_limit
        self._next = -np.inf

    def task(self, situation: Situation) -> SensorTask | None:
        """Return a measurement task if the next measurement is due, else None."""
        s = situation
        due = s.time >= self._next - 1e-9
        if not (due and self._last_altitude < s.altitude <= self._first_altitude):
            return None
        self._next = _next_due(self._next, s.time, self._interval)
        mount = gimbal_mount(s.estimate.attitude, s.site - s.estimate.position, self._limit)
        return SensorTask(self._sensor, mount)

    def stop(self) -> None:
        """Stop all further measurements."""
        self._next = np.inf


class SweepSchedule:
    """Schedule of a raster scan of a square around the site, then a dwell on the site.

    Parameters
    ----------
    sensor
        Name of the sensor.
    size
        Side of the square about the site, m.
    duration
        Duration of the scan, s.
    rate, dwell_rate
        Measurement rates during the scan and on the site, Hz.
    last_altitude
        Altitude above the site at and below which there are no measurements, m.
    gimbal_limit
        Maximum angle of the boresight from body -z, rad.
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
        gimbal_limit: float,
    ) -> None:
        self._sensor = sensor
        self._size = size
        self._duration = duration
        self._rate, self._dwell_rate = rate, dwell_rate
        self._last_altitude = last_altitude
        self._limit = gimbal_limit
        self._next = -np.inf
        self._count = 0

    def task(self, situation: Situation) -> SensorTask | None:
        """Return a measurement task if the next measurement is due, else None."""
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
        """Return the offset of the next aim point from the centre of the square (3,), m."""
        rows = max(2, round(np.sqrt(self._duration * self._rate)))
        row, col = divmod(self._count, rows)
        # Alternate the direction of the rows; start again if measurements are left.
        row %= rows
        col = col if row % 2 == 0 else rows - 1 - col
        step = self._size / (rows - 1)
        corner = 0.5 * self._size * np.array([1.0, 1.0, 0.0])
        return np.array([row * step, col * step, 0.0]) - corner

    def stop(self) -> None:
        """Stop all further measurements."""
        self._next = np.inf
