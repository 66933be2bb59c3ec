"""Directions of Sun and Earth: published values, and an independent computation."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.models.site import parse_time
from lunarsim.world.ephemeris import sky_at
from tests.reference import ephemeris as reference

TOLERANCE_DEG = 0.05


def _sky(latitude_deg, longitude_deg, *times):
    dates = np.array([parse_time("time", time) for time in times])
    return sky_at(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), dates)


# NASA Scientific Visualization Studio, "Moon Phase and Libration" 2020 (svs.gsfc.nasa.gov/4768),
# 2021 (4874) and 2022 (4955): files mooninfo_YEAR.txt, computed with DE421 in MOON_ME. Subsolar
# longitude and latitude, sub-Earth longitude and latitude, deg, lit fraction of the Moon, %.
VISUALIZATION_STUDIO = [
    ("2020-01-01T00:00Z", 114.557, -0.045, 0.773, 6.360, 29.95),
    ("2020-07-19T12:00Z", -169.884, 0.736, -5.393, -1.514, 1.82),
    ("2020-07-24T12:00Z", 128.870, 0.844, -1.399, -6.661, 17.82),
    ("2021-12-30T00:00Z", -132.317, -0.951, -4.988, -1.755, 19.72),
    ("2022-12-29T18:00Z", 100.848, -1.293, 7.277, 3.995, 46.82),
    ("2022-12-31T23:00Z", 74.007, -1.346, 7.054, 0.923, 69.55),
]


@pytest.mark.parametrize(("time", "sun_lon", "sun_lat", "lon", "lat", "lit"), VISUALIZATION_STUDIO)
def test_sun_and_earth_are_in_the_zenith_of_the_published_points(
    time, sun_lon, sun_lat, lon, lat, lit
):
    assert np.rad2deg(_sky(sun_lat, sun_lon, time).sun_elevation[0]) > 90.0 - 0.01
    earth = _sky(lat, lon, time)
    assert np.rad2deg(earth.earth_elevation[0]) > 90.0 - 0.01
    # The phases of Earth and Moon complement each other, except for the angle at the Sun.
    assert earth.earth_phase[0] == pytest.approx(1.0 - 0.01 * lit, abs=0.003)


def test_the_example_of_meeus():
    """Meeus, Astronomical Algorithms (1998), example 53.a: 1992 April 12, 0 h TD, 59 s after UTC.

    The book states two digits; it refers to the mean equator of Eckhardt's theory.
    """
    time = "1992-04-11T23:59:01Z"
    assert np.rad2deg(_sky(1.46, 67.89, time).sun_elevation[0]) > 90.0 - TOLERANCE_DEG
    assert np.rad2deg(_sky(4.20, -1.23, time).earth_elevation[0]) > 90.0 - TOLERANCE_DEG


def test_the_example_of_skyfield():
    """Skyfield documentation, "Planetary Reference Frames": the Earth above Aristarchus, DE421."""
    sky = _sky(26.3, -46.8, "2019-12-20T11:05Z")
    wanted = 32 + 27 / 60 + 9.7 / 3600, 118 + 12 / 60 + 55.9 / 3600
    found = np.rad2deg([sky.earth_elevation[0], sky.earth_azimuth[0]])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=0.01)


# Apollo Lunar Surface Journal, "Sun and Earth: Altitudes and Azimuths at the Apollo Landing Sites"
# (nasa.gov/history/alsj/alsj-EarthSun_AltAz.html, Scotti 2009): landing and liftoff; elevation and
# azimuth of the Sun, deg. The page states 0.5 deg as the limit of the differences between its two
# computations; its directions of the Earth lack the parallax. The start of the walk of Apollo 11,
# 13.84 deg, is not used: it is 0.05 deg below the line between landing and liftoff.
APOLLO = [
    (0.6875, 23.4333, "1969-07-20T20:17:39Z", 10.65, 88.81),
    (0.6875, 23.4333, "1969-07-21T17:54:00Z", 21.65, 88.91),
    (-3.1975, -23.3856, "1969-11-19T06:54:36Z", 5.19, 91.16),
    (-3.1975, -23.3856, "1969-11-20T14:25:47Z", 21.11, 90.33),
]


@pytest.mark.parametrize(("latitude", "longitude", "time", "elevation", "azimuth"), APOLLO)
def test_the_sun_at_apollo_landings(latitude, longitude, time, elevation, azimuth):
    sky = _sky(latitude, longitude, time)
    found = np.rad2deg([sky.sun_elevation[0], sky.sun_azimuth[0]])
    np.testing.assert_allclose(found, (elevation, azimuth), rtol=0, atol=TOLERANCE_DEG)


def test_an_independent_computation_agrees():
    """Astropy's ephemeris with the rotation of the IAU written again, 1900 to 2099."""
    rng = np.random.default_rng(20)
    for year in (1900, 1935, 1969, 1992, 2008, 2026, 2035, 2060, 2099):
        day = np.datetime64(f"{year}-01-01", "us") + np.timedelta64(int(rng.integers(365)), "D")
        latitude, longitude = rng.uniform(-88.0, 88.0), rng.uniform(-180.0, 360.0)
        sky = sky_at(*np.deg2rad([latitude, longitude]), np.array([day]))
        sun, earth = reference.directions(latitude, longitude, str(day))
        for (azimuth, elevation), found in (
            (sun, (sky.sun_azimuth[0], sky.sun_elevation[0])),
            (earth, (sky.earth_azimuth[0], sky.earth_elevation[0])),
        ):
            off = (np.rad2deg(found[0]) - azimuth + 180.0) % 360.0 - 180.0
            assert abs(off) * np.cos(np.deg2rad(elevation)) < 0.02, year
            assert abs(np.rad2deg(found[1]) - elevation) < 0.02, year


def test_the_site_shifts_the_earth():
    """At the eastern limb, the parallax lowers the Earth by the radius over the distance."""
    sky = _sky(0.0, 90.0, "2027-03-01T12:00Z")
    unshifted = reference.directions(0.0, 90.0, "2027-03-01T12:00:00", radius_km=0.0)[1][1]
    shift = unshifted - np.rad2deg(sky.earth_elevation[0])
    distance = 6_371.0 / np.sin(0.5 * sky.earth_diameter[0])
    assert shift == pytest.approx(np.rad2deg(reference.MOON_RADIUS_KM / distance), abs=0.01)
    assert 0.2 < shift < 0.3


def test_diameters_and_earthshine_have_their_published_ranges():
    """Sun 31.5 to 32.7 arc minutes, Earth about 1.8 to 2.0 deg; full Earth 1.2e-4 of sunlight."""
    year = np.datetime64("2027-01-01", "us") + np.arange(0, 366, 3).astype("timedelta64[D]")
    sky = sky_at(0.0, 0.0, year)
    sun, earth = np.rad2deg(sky.sun_diameter), np.rad2deg(sky.earth_diameter)
    assert 0.522 < sun.min() < 0.526
    assert 0.541 < sun.max() < 0.546
    assert 1.79 < earth.min() < 1.82
    assert 1.99 < earth.max() < 2.06
    full = sky.earth_phase > 0.99
    assert full.any()
    assert 1.0e-4 < sky.earthshine[full].min() <= sky.earthshine.max() < 1.45e-4
    assert sky.earthshine[sky.earth_phase < 0.01].max() < 1e-6
    half = np.abs(sky.earth_phase - 0.5) < 0.05  # Lambert's sphere at 90 deg: 1 / pi of full
    assert sky.earthshine[half].mean() == pytest.approx(1.2e-4 / np.pi, rel=0.15)
