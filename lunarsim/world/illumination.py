"""Hours of sunlight and of Earth in view at a site, and windows for a landing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lunarsim.errors import InputError
from lunarsim.models.site import LAST_YEAR
from lunarsim.typing import Array
from lunarsim.world.ephemeris import Sky, sky_at
from lunarsim.world.horizon import Horizon

_HOUR = np.timedelta64(3_600_000_000, "us")
_MAX_STEPS = 100_000
_END_OF_EPHEMERIS = np.datetime64(f"{LAST_YEAR + 1}-01-01", "us")
# Points at which the mean visible fraction of the Sun in a window is taken.
_SAMPLES_PER_WINDOW = 64


class Window(NamedTuple):
    """Time interval with a mean visible fraction of the Sun's disc.

    `starts_before` and `ends_after` state whether it continues outside the period.
    """

    start: np.datetime64
    end: np.datetime64
    starts_before: bool
    ends_after: bool
    sun_visible: float

    @property
    def hours(self) -> float:
        """Duration within the period, h."""
        return float((self.end - self.start) / _HOUR)


@dataclass(frozen=True)
class Illumination:
    """Sun and Earth above the terrain horizon of a site during a period.

    Times between samples are interpolated linearly.

    Attributes
    ----------
    sky
        Sun and Earth at equally spaced times.
    horizon
        Terrain horizon of the site.
    """

    sky: Sky
    horizon: Horizon

    @classmethod
    def over(
        cls, latitude: float, longitude: float, horizon: Horizon, start: np.datetime64, days: float,
        step_hours: float,
    ) -> Illumination:  # fmt: skip
        """Return the illumination of a site from a date on.

        Parameters
        ----------
        latitude, longitude
            Planetocentric position of the site in MOON_ME, rad.
        horizon
            Terrain horizon of the site.
        start
            First date and time, UTC.
        days
            Length of the period, days.
        step_hours
            Time between two samples, h.

        Raises
        ------
        InputError
            If the period has fewer than two samples, or over 100,000, or ends after the years of
            the ephemeris.
        """
        steps = 24.0 * days / step_hours
        if not 1.0 <= steps <= _MAX_STEPS:
            raise InputError(
                "days", days, f"must be from 1 to {_MAX_STEPS} times the step of {step_hours:g} h"
            )
        if start + np.timedelta64(round(86_400.0 * days), "s") >= _END_OF_EPHEMERIS:
            raise InputError("days", days, f"must end the period by the end of {LAST_YEAR}")
        micro = np.round(3.6e9 * step_hours * np.arange(int(steps + 1e-9) + 1))
        return cls(sky_at(latitude, longitude, start + micro.astype("timedelta64[us]")), horizon)

    @cached_property
    def sun_visible(self) -> Array:
        """Visible fraction of the Sun's disc above the terrain horizon (n,)."""
        sky = self.sky
        return self.horizon.visible_fraction(sky.sun_azimuth, sky.sun_elevation, sky.sun_diameter)

    @cached_property
    def sun_horizon(self) -> Array:
        """Elevation of the terrain horizon at the azimuth of the Sun (n,), rad."""
        return self.horizon.elevation_at(self.sky.sun_azimuth)

    @cached_property
    def earth_horizon(self) -> Array:
        """Elevation of the terrain horizon at the azimuth of the Earth (n,), rad."""
        return self.horizon.elevation_at(self.sky.earth_azimuth)

    @property
    def hours(self) -> float:
        """Length of the period, h."""
        return float((self.sky.time[-1] - self.sky.time[0]) / _HOUR)

    @property
    def illuminated_hours(self) -> float:
        """Time integral of the visible fraction of the Sun's disc, h."""
        return float(np.trapezoid(self.sun_visible) * self.hours / (self.sun_visible.size - 1))

    @property
    def earth_hours(self) -> float:
        """Time with the centre of the Earth above the terrain horizon, h."""
        return sum((one.hours for one in self.earth_in_view()), 0.0)

    def sunlit(self) -> list[Window]:
        """Return the intervals from sunrise to sunset.

        The upper limb of the Sun is then above the terrain horizon at the azimuth of its centre.
        """
        sky = self.sky
        return self._intervals(sky.sun_elevation + 0.5 * sky.sun_diameter - self.sun_horizon)

    def earth_in_view(self) -> list[Window]:
        """Return the intervals with the Earth's centre above the terrain horizon."""
        return self._intervals(self.sky.earth_elevation - self.earth_horizon)

    def landing_windows(self, min_elevation: float, max_elevation: float) -> list[Window]:
        """Return the intervals with the Sun in a range of elevations and Earth in view.

        The elevations, rad, are those of the Sun's centre above the horizontal plane.
        """
        sun, earth = self.sky.sun_elevation, self.sky.earth_elevation - self.earth_horizon
        signal = np.minimum(np.minimum(sun - min_elevation, max_elevation - sun), earth)
        return self._intervals(signal)

    def _intervals(self, signal: Array) -> list[Window]:
        """Return the intervals in which an interpolated signal (n,) is positive."""
        above = signal > 0.0
        last_place = float(signal.size - 1)
        changes = np.flatnonzero(above[1:] != above[:-1])
        crossings = changes + signal[changes] / (signal[changes] - signal[changes + 1])
        ends = [0.0] if above[0] else []
        ends += crossings.tolist()
        ends += [last_place] if above[-1] else []
        return [
            self._window(first, last, (first == 0.0, last == last_place))
            for first, last in zip(ends[::2], ends[1::2], strict=True)
        ]

    def _window(self, first: float, last: float, is_cut: tuple[bool, bool]) -> Window:
        """Return the window between two places in the samples.

        Places may lie between samples. `is_cut` states whether the window continues before the
        period, and after it.
        """
        at = np.linspace(first, last, _SAMPLES_PER_WINDOW)
        visible = float(np.interp(at, np.arange(self.sun_visible.size), self.sun_visible).mean())
        start, end = (self._time_at(place) for place in (first, last))
        return Window(start, end, *is_cut, visible)

    def _time_at(self, place: float) -> np.datetime64:
        """Return the time at a place between samples, to the second."""
        step = (self.sky.time[1] - self.sky.time[0]) / np.timedelta64(1, "s")
        seconds = np.timedelta64(round(place * float(step)), "s")
        return np.datetime64(self.sky.time[0] + seconds)
