"""Elevation angle of the terrain horizon around a point on a spherical Moon.

The terrain is any function of arc lengths east and north that returns heights above the sphere,
for instance `FarTerrain.elevation`, or one or more heightfields.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.typing import Array
from lunarsim.world._horizon_kernels import raise_to_terrain
from lunarsim.world.terrain import Heightfield

# Heights (n,), m, at arc lengths (n, 2) east and north, m.
HeightFunction = Callable[[Array], Array]
# Number of azimuths of a horizon: half the diameter of the Sun, 0.25 deg, apart.
AZIMUTHS = 1440
# Distance between samples over distance from the observer. On a slope of 30 deg, a summit between
# two samples is missed by at most 0.5 * tan(30 deg) of it, 0.017 deg.
_STEP_RATIO = 1e-3
# Azimuths that are sampled together, to limit memory.
_AZIMUTHS_PER_BLOCK = 48
# Strips into which a disc is divided to find its visible fraction.
_STRIPS = 16


@dataclass(frozen=True)
class Horizon:
    """Elevation angles of the terrain horizon at equally spaced azimuths.

    Attributes
    ----------
    elevation
        Elevation angle of the horizon (n,), rad. The first azimuth is north (0), and azimuths
        increase clockwise by 2 pi / n.
    reach
        Arc length to the farthest known terrain at each azimuth (n,), m; 0 if none is known.
    """

    elevation: Array
    reach: Array

    @property
    def azimuth(self) -> Array:
        """Azimuths (n,), clockwise from north, rad."""
        return 2.0 * np.pi * np.arange(self.elevation.size) / self.elevation.size

    def elevation_at(self, azimuth: ArrayLike) -> Array:
        """Interpolate the elevation angle of the horizon, rad, at azimuths (...,), rad."""
        at = np.asarray(azimuth, dtype=np.float64)
        return np.asarray(np.interp(at, self.azimuth, self.elevation, period=2.0 * np.pi))

    def visible_fraction(
        self, azimuth: ArrayLike, elevation: ArrayLike, diameter: ArrayLike
    ) -> Array:
        """Return the visible fractions (...,) of discs such as that of the Sun.

        `azimuth` and `elevation` (...,) are the directions of the centres and `diameter` (...,)
        the apparent diameters, rad. The disc is divided into vertical strips.
        """
        az, el = (np.asarray(v, dtype=np.float64)[..., None] for v in (azimuth, elevation))
        radius = 0.5 * np.asarray(diameter, dtype=np.float64)[..., None]
        across = (2.0 * np.arange(_STRIPS) + 1.0) / _STRIPS - 1.0
        half = radius * np.sqrt(1.0 - across**2)
        edge = self.elevation_at(az + radius * across / np.maximum(np.cos(el), 1e-6))
        lit = np.clip(0.5 + 0.5 * (el - edge) / half, 0.0, 1.0)
        return np.asarray((lit * half).sum(-1) / half.sum(-1))


def smooth_horizon(height: float, radius: float) -> Horizon:
    """Return the horizon of a smooth sphere of a radius, m, from a height above it, m."""
    dip = float(np.arccos(radius / (radius + height)))
    return Horizon(np.full(AZIMUTHS, -dip), np.zeros(AZIMUTHS))


def terrain_horizon(
    terrain: HeightFunction | Heightfield | Sequence[Heightfield],
    position: ArrayLike = (0.0, 0.0),
    *,
    height: float,
    radius: float,
    posting: float,
    max_range: float,
    azimuths: int = AZIMUTHS,
) -> Horizon:
    """Return the horizon around a point from the terrain out to a maximum range.

    Beyond the known terrain, the surface is the sphere through the terrain below the observer.

    Parameters
    ----------
    terrain
        Function from arc lengths (n, 2) east and north, m, to heights (n,) above the sphere, m,
        with NaN for unknown heights; or heightfields in these coordinates, of which the first one
        that covers a point counts.
    position
        Arc lengths (2,) of the observer, east and north, m.
    height
        Height of the observer above the terrain, m.
    radius
        Radius of the sphere, m.
    posting
        Grid spacing of the finest terrain, m. The first sample is at half of it.
    max_range
        Maximum arc length from the observer, m.
    azimuths
        Number of azimuths.

    Raises
    ------
    InputError
        If a length is not positive, or the terrain is unknown below the observer.

    Examples
    --------
    >>> plain = terrain_horizon(
    ...     lambda arc: np.zeros(len(arc)), height=2.0, radius=1_737_400.0, posting=40.0,
    ...     max_range=20_000.0,
    ... )
    >>> np.rad2deg(plain.elevation).round(3)[:2]  # dip of the horizon of a sphere
    array([-0.087, -0.087])
    """
    lengths = {"radius": radius, "posting": posting, "max_range": max_range}
    for name, length in lengths.items():
        if not (np.isfinite(length) and length > 0.0):
            raise InputError(f"horizon.{name}", length, "must be positive and finite, in m")
    if not (np.isfinite(height) and height >= 0.0):
        raise InputError("horizon.height", height, "must be 0 or more and finite, in m")
    heights_at = terrain if callable(terrain) else height_function(terrain)
    here = np.asarray(position, dtype=np.float64)
    base = float(heights_at(here[None, :])[0])
    if not np.isfinite(base):
        raise InputError(
            "horizon.position", tuple(here.tolist()), "must be on terrain with a known height"
        )
    first = min(0.5 * posting, max_range)
    s = np.geomspace(first, max_range, 2 + int(np.log(max_range / first) / _STEP_RATIO))
    angle = np.full(azimuths, -np.arccos((radius + base) / (radius + base + height)))
    reach = np.zeros(azimuths)
    azimuth = 2.0 * np.pi * np.arange(azimuths) / azimuths
    for first in range(0, azimuths, _AZIMUTHS_PER_BLOCK):
        part = slice(first, first + _AZIMUTHS_PER_BLOCK)
        towards = np.stack([np.sin(azimuth[part]), np.cos(azimuth[part])], axis=-1)
        at = here + s[None, :, None] * towards[:, None, :]
        z = np.asarray(heights_at(at.reshape(-1, 2)), dtype=np.float64).reshape(at.shape[:2])
        raise_to_terrain(angle[part], reach[part], z, s, base + height, radius)
    return Horizon(angle, reach)


def height_function(fields: Heightfield | Sequence[Heightfield]) -> HeightFunction:
    """Return the function that interpolates heightfields linearly.

    The first heightfield that covers a point counts; points outside all of them are NaN.
    """
    given = [fields] if isinstance(fields, Heightfield) else list(fields)

    def heights(arc: Array) -> Array:
        z = np.full(len(arc), np.nan)
        for one in given:
            g = one.grid
            at = (arc[:, 1] - g.y0) / g.posting, (arc[:, 0] - g.x0) / g.posting
            # Unknown posts make only the points next to them unknown.
            found = ndimage.map_coordinates(
                one.z.astype(np.float64), at, order=1, mode="constant", cval=np.nan
            )
            z = np.where(np.isnan(z), found, z)
        return z

    return heights
