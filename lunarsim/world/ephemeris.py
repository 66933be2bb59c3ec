"""Directions of Sun and Earth above a site on the Moon.

Positions of Sun, Earth and Moon come from the package astronomy-engine (VSOP87 and the lunar theory
of Montenbruck and Pfleger, within 1 arc minute). The orientation of the Moon is the series of the
IAU (Archinal et al. 2011, Celestial Mechanics and Dynamical Astronomy 109, 101-135), which gives
the frame MOON_ME (mean Earth, polar axis) to about 150 m on the surface, 0.005 deg. Directions are
apparent: corrected for light time and aberration, and for the parallax of the site.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import enu_axes
from lunarsim.typing import Array
from lunarsim.world.light import FULL_EARTH_IRRADIANCE_RATIO

# Mean radius of the Moon (IAU), radii of Sun (nominal, IAU 2015) and Earth (mean), m.
MOON_RADIUS_M, SUN_RADIUS_M, EARTH_RADIUS_M = 1_737_400.0, 695_700_000.0, 6_371_000.0
# Mean distance of the Earth, to which `FULL_EARTH_IRRADIANCE_RATIO` refers, m.
_MEAN_EARTH_DISTANCE_M = 384_400_000.0
_LIGHT_SPEED_M_S = 299_792_458.0
_METRES_PER_AU = 149_597_870_700.0
_SECONDS_PER_DAY = 86_400.0
_J2000 = np.datetime64("2000-01-01T12:00:00", "us")


@dataclass(frozen=True)
class Sky:
    """Sun and Earth above a site at n times.

    Attributes
    ----------
    time
        Dates and times (n,), UTC.
    sun_azimuth, sun_elevation, earth_azimuth, earth_elevation
        Directions of the centres (n,), rad: azimuth clockwise from north, elevation above the
        horizontal plane.
    sun_diameter, earth_diameter
        Apparent diameters (n,), rad.
    earth_phase
        Sunlit fractions (n,) of the disc of the Earth.
    earthshine
        Irradiance (n,) from the Earth over that from the Sun, for an Earth that reflects like
        Lambert's law and has the albedo of `FULL_EARTH_IRRADIANCE_RATIO`.
    """

    time: NDArray[np.datetime64]
    sun_azimuth: Array
    sun_elevation: Array
    sun_diameter: Array
    earth_azimuth: Array
    earth_elevation: Array
    earth_diameter: Array
    earth_phase: Array
    earthshine: Array


def sky_at(latitude: float, longitude: float, times: NDArray[np.datetime64]) -> Sky:
    """Return the directions of Sun and Earth at a site on the mean sphere of the Moon.

    Parameters
    ----------
    latitude, longitude
        Planetocentric position of the site in MOON_ME, rad, positive north and east.
    times
        Dates and times (n,), UTC.
    """
    axes = enu_axes(latitude, longitude)
    site = MOON_RADIUS_M * axes[:, 2]
    both = np.array([_sun_and_earth(_days_since_j2000(time)) for time in times])
    sun, earth = both[:, 0], both[:, 1]
    from_earth_to_sun = sun - earth
    cos_phase = -(earth * from_earth_to_sun).sum(-1) / (
        np.linalg.norm(earth, axis=-1) * np.linalg.norm(from_earth_to_sun, axis=-1)
    )
    phase = np.arccos(np.clip(cos_phase, -1.0, 1.0))
    lambert = (np.sin(phase) + (np.pi - phase) * np.cos(phase)) / np.pi
    sun, earth = (sun - site) @ axes, (earth - site) @ axes
    sun_distance, earth_distance = (np.linalg.norm(v, axis=-1) for v in (sun, earth))
    return Sky(
        np.asarray(times),
        np.arctan2(sun[:, 0], sun[:, 1]) % (2.0 * np.pi),
        np.arcsin(sun[:, 2] / sun_distance),
        2.0 * np.arcsin(SUN_RADIUS_M / sun_distance),
        np.arctan2(earth[:, 0], earth[:, 1]) % (2.0 * np.pi),
        np.arcsin(earth[:, 2] / earth_distance),
        2.0 * np.arcsin(EARTH_RADIUS_M / earth_distance),
        0.5 * (1.0 + np.cos(phase)),
        FULL_EARTH_IRRADIANCE_RATIO * lambert * (_MEAN_EARTH_DISTANCE_M / earth_distance) ** 2,
    )


def _days_since_j2000(time: np.datetime64) -> float:
    return float((time - _J2000) / np.timedelta64(1, "us")) / (1e6 * _SECONDS_PER_DAY)


@lru_cache(maxsize=2048)
def _sun_and_earth(days: float) -> Array:
    """Return Sun and Earth (2, 3), m, from the Moon's centre in MOON_ME.

    They are where they appear. `days` are those of UTC since 2000-01-01T12:00.
    """
    import astronomy  # noqa: PLC0415  (loads slowly)

    time = astronomy.Time(days)
    earth, moon = astronomy.BaryState(astronomy.Body.Earth, time), astronomy.GeoMoonState(time)
    observer = _metres(earth) + _metres(moon)
    velocity = np.array([earth.vx + moon.vx, earth.vy + moon.vy, earth.vz + moon.vz])
    velocity = velocity * _METRES_PER_AU / _SECONDS_PER_DAY
    to_moon = _moon_axes(astronomy.RotationAxis(astronomy.Body.Moon, time))
    found = []
    for body in (astronomy.Body.Sun, astronomy.Body.Earth):
        seen = _metres(astronomy.BaryState(body, time)) - observer
        for _ in range(2):  # light time
            delay = float(np.linalg.norm(seen)) / _LIGHT_SPEED_M_S / _SECONDS_PER_DAY
            seen = _metres(astronomy.BaryState(body, time.AddDays(-delay))) - observer
        distance = float(np.linalg.norm(seen))
        aberrated = seen / distance + velocity / _LIGHT_SPEED_M_S
        found.append(to_moon @ (distance * aberrated / np.linalg.norm(aberrated)))
    return np.array(found)


def _metres(state: Any) -> Array:
    """Return the position (3,), m, of a state vector of astronomy-engine."""
    return _METRES_PER_AU * np.array([state.x, state.y, state.z])


def _moon_axes(axis: Any) -> Array:
    """Return the axes (3, 3) of MOON_ME in the equatorial frame J2000.

    `axis` is the pole (hours, deg) and the prime meridian (deg) of the IAU model.
    """
    alpha, delta, w = np.deg2rad([15.0 * axis.ra, axis.dec, axis.spin])
    pole = np.array([np.cos(delta) * np.cos(alpha), np.cos(delta) * np.sin(alpha), np.sin(delta)])
    node = np.array([-np.sin(alpha), np.cos(alpha), 0.0])
    x = np.cos(w) * node + np.sin(w) * np.cross(pole, node)
    return np.array([x, np.cross(pole, x), pole])
