"""Sunlight on the map that terrain beyond the map obstructs.

Each vertical strip of the Sun's disc has an azimuth. Towards it, the terrain beyond the map is
swept along parallel lines: on each line, the terrain that casts the highest shadow is found once
for all points of the map. Its elevation angle at a point is exact, also at the point's own height.
Of a strip, shadows of its lower end and of its middle are found: terrain below the lower end hides
nothing. The visible part of the disc follows as in `Horizon.visible_fraction`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.typing import Array
from lunarsim.world import _far_terrain_kernels as kernels
from lunarsim.world.far_terrain import FarTerrain
from lunarsim.world.light import Light

# Number of vertical strips of the Sun's disc, and maximum number of lines.
_STRIPS, _MAX_LINES = 8, 1024
# A line of about a thousand points takes this time, microseconds.
_LINE_TIME_US = 300.0
# Maximum number of Sun directions whose shadows a far terrain keeps.
_MAX_KEPT = 4
_MAX_ELEVATION = np.deg2rad(85.0)
# Minimum tangent of an elevation for which shadows are found: 0.03 deg.
_MIN_SLOPE = 5e-4


@dataclass(frozen=True)
class _Strip:
    """Shadows on the map from one strip of the Sun's disc.

    Attributes
    ----------
    towards
        Horizontal unit vector to the strip (2,), east and north.
    half
        Half the height of the strip, rad; 0: the Sun is a point.
    across
        Coordinates of the lines to the left of `towards` (n,), m.
    slopes, shadow, place
        Tangents of elevations (m,); for each of them, the height of the shadow above the origin,
        and the distance of the terrain that casts it (m, n), m.
    """

    towards: Array
    half: float
    across: Array
    slopes: tuple[float, ...]
    shadow: Array
    place: Array

    def horizon(self, points: Array) -> Array:
        """Return the elevation angle, rad, of the terrain beyond the map at points (n, 3)."""
        along = points[:, :2] @ self.towards
        left = points[:, 1] * self.towards[0] - points[:, 0] * self.towards[1]
        angle = np.full(len(points), -0.5 * np.pi)
        for slope, shadow, place in zip(self.slopes, self.shadow, self.place, strict=True):
            away = np.interp(left, self.across, place)
            top = np.interp(left, self.across, shadow) + away * slope
            angle = np.maximum(angle, np.arctan2(top - points[:, 2], away - along))
        return angle


@dataclass(frozen=True)
class FarShadow:
    """Shadows of the terrain beyond the map on the map, for one direction of the Sun.

    Attributes
    ----------
    elevation
        Elevation of the Sun, rad.
    strips
        Strips of the Sun's disc.
    """

    elevation: float
    strips: tuple[_Strip, ...]

    @classmethod
    def of(cls, terrain: FarTerrain, light: Light) -> FarShadow:
        """Return the shadows for a light; those of the last directions are kept."""
        kept, key = terrain.shadows, (light.azimuth, light.elevation, light.diameter)
        if key not in kept:
            if len(kept) >= _MAX_KEPT:
                del kept[next(iter(kept))]
            kept[key] = cls(light.elevation, tuple(_strips(terrain, *key)))
        found: FarShadow = kept[key]
        return found

    def sunlight(self, points: Array) -> Array:
        """Return the visible fraction (n,) of the Sun's disc at points (n, 3), m.

        Only terrain beyond the map obstructs it.
        """
        lit, total = np.zeros(len(points)), 0.0
        for strip in self.strips:
            above = self.elevation - strip.horizon(points)
            if strip.half == 0.0:
                return np.where(above > 0.0, 1.0, 0.0)
            lit += strip.half * np.clip(0.5 + 0.5 * above / strip.half, 0.0, 1.0)
            total += strip.half
        return lit / total if self.strips else np.ones(len(points))


def _strips(
    terrain: FarTerrain, azimuth: float, elevation: float, diameter: float
) -> list[_Strip]:  # fmt: skip
    """Return the strips of the Sun's disc; none if the Sun is near the zenith."""
    if elevation > _MAX_ELEVATION:
        return []
    if diameter == 0.0:
        return [_swept(terrain, azimuth, elevation, 0.0)]
    radius = 0.5 * diameter
    across = (2.0 * np.arange(_STRIPS) + 1.0) / _STRIPS - 1.0
    return [
        _swept(terrain, azimuth + radius * u / np.cos(elevation), elevation, half)
        for u, half in zip(across, radius * np.sqrt(1.0 - across**2), strict=True)
    ]


def _swept(terrain: FarTerrain, azimuth: float, elevation: float, half: float) -> _Strip:
    """Sweep the terrain beyond the map along lines towards an azimuth of the Sun."""
    towards = np.array([np.sin(azimuth), np.cos(azimuth)])
    west, east, south, north = terrain.terrain.bounds
    corners = np.array([[x, y] for x in (west, east) for y in (south, north)])
    left = corners @ np.array([-towards[1], towards[0]])
    posting = terrain.terrain.relief.grid.posting
    count = int(np.clip((left.max() - left.min()) / posting, 2, _MAX_LINES)) + 1
    across = np.linspace(left.min(), left.max(), count)
    start = np.full(count, np.inf)
    edges = ((west, east), (south, north))
    for axis, (offset, (low, high)) in enumerate(
        zip((-towards[1], towards[0]), edges, strict=True)
    ):
        if abs(towards[axis]) > 1e-9:
            edge = high if towards[axis] > 0.0 else low
            start = np.minimum(start, (edge - across * offset) / towards[axis])
    elevations = (elevation,) if half == 0.0 else (elevation - half, elevation)
    slopes = tuple(max(float(np.tan(e)), _MIN_SLOPE) for e in elevations)
    shadow, place = np.empty((len(slopes), count)), np.empty((len(slopes), count))
    for k, slope in enumerate(slopes):
        kernels.sweep_shadow.run_loop(
            count, _LINE_TIME_US, across, start, terrain.surface.extent, towards, slope,
            terrain.surface, shadow[k], place[k],
        )  # fmt: skip
    return _Strip(towards, float(half), across, slopes, shadow, place)
