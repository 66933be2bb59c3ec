"""Directions of Sun and Earth on the Moon by astropy, and the IAU's series for its rotation.

Archinal et al. 2011, Report of the IAU Working Group on Cartographic Coordinates and Rotational
Elements: 2009, table 2. Positions are those of astropy's built-in ephemeris (ERFA: epv00, moon98).
"""

import warnings

import numpy as np
from astropy.coordinates import get_body_barycentric, get_body_barycentric_posvel
from astropy.time import Time, TimeDelta
from erfa import ErfaWarning

MOON_RADIUS_KM = 1737.4
LIGHT_KM_S = 299_792.458
# E1 to E13: deg at J2000 and deg per day.
ARGUMENTS = (
    (125.045, -0.0529921), (250.089, -0.1059842), (260.008, 13.0120009), (176.625, 13.3407154),
    (357.529, 0.9856003), (311.589, 26.4057084), (134.963, 13.0649930), (276.617, 0.3287146),
    (34.226, 1.7484877), (15.134, -0.1589763), (119.743, 0.0036096), (239.961, 0.1643573),
    (25.053, 12.9590088),
)  # fmt: skip
# Amplitudes of sin E (right ascension), cos E (declination) and sin E (prime meridian), deg.
RIGHT_ASCENSION = {1: -3.8787, 2: -0.1204, 3: 0.0700, 4: -0.0172, 6: 0.0072, 10: -0.0052,
                   13: 0.0043}  # fmt: skip
DECLINATION = {1: 1.5419, 2: 0.0239, 3: -0.0278, 4: 0.0068, 6: -0.0029, 7: 0.0009, 10: 0.0008,
               13: -0.0009}  # fmt: skip
MERIDIAN = {1: 3.5610, 2: 0.1208, 3: -0.0642, 4: 0.0158, 5: 0.0252, 6: -0.0066, 7: -0.0047,
            8: -0.0046, 9: 0.0028, 10: 0.0052, 11: 0.0040, 12: 0.0019, 13: -0.0044}  # fmt: skip


def _turn(axis, degrees):
    """Return the matrix of a rotation of the axes about axis 0 (x) or 2 (z)."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    if axis == 0:
        return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def moon_rotation(days):
    """Return the matrix from J2000 to axes fixed to the Moon; `days` since J2000 (TDB)."""
    e = {k + 1: np.radians(start + rate * days) for k, (start, rate) in enumerate(ARGUMENTS)}
    centuries = days / 36525.0
    alpha = (
        269.9949 + 0.0031 * centuries + sum(a * np.sin(e[k]) for k, a in RIGHT_ASCENSION.items())
    )
    delta = 66.5392 + 0.0130 * centuries + sum(a * np.cos(e[k]) for k, a in DECLINATION.items())
    w = 38.3213 + 13.17635815 * days - 1.4e-12 * days**2
    w += sum(a * np.sin(e[k]) for k, a in MERIDIAN.items())
    return _turn(2, w) @ _turn(0, 90.0 - delta) @ _turn(2, 90.0 + alpha)


def directions(latitude_deg, longitude_deg, utc, radius_km=MOON_RADIUS_KM):
    """Return azimuth and elevation, deg, of the Sun, and of the Earth, at a site on the Moon."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ErfaWarning)  # leap seconds before 1960 and in future
        return _directions(latitude_deg, longitude_deg, Time(utc, scale="utc"), radius_km)


def _directions(latitude_deg, longitude_deg, time, radius_km):
    moon = get_body_barycentric("moon", time, ephemeris="builtin").xyz.to_value("km")
    velocity = get_body_barycentric_posvel("earth", time, ephemeris="builtin")[1]
    velocity = velocity.xyz.to_value("km/s")
    fixed = moon_rotation(time.tdb.jd - 2451545.0)
    lat, lon = np.radians([latitude_deg, longitude_deg])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    north = np.cross(up, east)
    out = []
    for body in ("sun", "earth"):
        seen, delay = None, 0.0
        for _ in range(3):
            at = time - TimeDelta(delay, format="sec")
            seen = get_body_barycentric(body, at, ephemeris="builtin").xyz.to_value("km") - moon
            delay = np.linalg.norm(seen) / LIGHT_KM_S
        seen = seen + np.linalg.norm(seen) * velocity / LIGHT_KM_S  # aberration
        local = fixed @ seen - radius_km * up
        x, y, z = local @ east, local @ north, local @ up
        out.append(
            (np.degrees(np.arctan2(x, y)) % 360.0, np.degrees(np.arcsin(z / np.linalg.norm(local))))
        )
    return out
