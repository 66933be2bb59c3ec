"""The true environment that the sensors observe."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.models.gravity import CentralGravity
from lunarsim.typing import Array
from lunarsim.world.dust import Dust, DustSheet
from lunarsim.world.far_terrain import FarTerrain
from lunarsim.world.light import Light
from lunarsim.world.terrain import RayHits, Terrain

# Hits of one ray on the map and on the far terrain that are no farther apart are one hit, m.
_SAME_HIT_M = 0.01


@dataclass(frozen=True)
class World:
    """True environment of a flight: terrain, gravity and illumination.

    Attributes
    ----------
    terrain
        True terrain of the map area.
    gravity
        Uniform downward acceleration, m/s^2; used only if `moon` is None.
    moon
        Spherical Moon with central gravity, for descents from orbit; None: flat terrain and uniform
        gravity.
    far_terrain
        Terrain beyond the map; None: rays that leave the map hit nothing.
    light
        Sun, Earth and photometry of the terrain; cameras and star trackers depend on it.
    dust
        Dust that the engine lifts; None: none.
    """

    terrain: Terrain
    gravity: float
    light: Light = field(default_factory=Light)
    moon: CentralGravity | None = None
    far_terrain: FarTerrain | None = None
    dust: Dust | None = None

    def dust_sheet(self, position: Array, attitude: Array, thrust: float) -> DustSheet | None:
        """Return the dust under the engine; None if there is none (`Dust.sheet`)."""
        if self.dust is None:
            return None
        return self.dust.sheet(self.terrain, position, attitude, thrust)

    def cast(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        max_range: float = np.inf,
        *,
        normals: bool = True,
    ) -> RayHits:
        """Intersect rays with the map and with the far terrain.

        `origin`, (3,) or (n, 3), ENU, m, is the start of the rays, `direction` (n, 3) their unit
        vectors and `max_range` the maximum range, m. Returns range, normal and rock index of each
        first hit. A ray that hits neither has NaN and the index -2. Without `normals`, the array of
        normals is empty.
        """
        hits = self.terrain.cast(origin, direction, max_range, normals=normals)
        if self.far_terrain is None:
            return hits
        start = np.asarray(origin, dtype=np.float64)
        west, east, south, north = self.terrain.bounds
        over = (np.abs(start[..., 0] - 0.5 * (west + east)) <= 0.5 * (east - west)) & (
            np.abs(start[..., 1] - 0.5 * (south + north)) <= 0.5 * (north - south)
        )
        # A ray from above the map that hits the map does not leave it before.
        left = np.flatnonzero(~(over & np.isfinite(hits.range)))
        if not left.size:
            return hits
        rays = np.asarray(direction, dtype=np.float64)[left]
        far = self.far_terrain.cast(start if start.ndim == 1 else start[left], rays, max_range)
        # The far terrain includes the relief of the map: hits there are the same ones.
        nearer = np.isfinite(far.range) & ~(far.range >= hits.range[left] - _SAME_HIT_M)
        at = left[nearer]
        hits.range[at], hits.rock[at] = far.range[nearer], far.rock[nearer]
        if normals:
            hits.normal[at] = far.normal[nearer]
        return hits

    def is_below_terrain(self, position: Array, min_elevation: float) -> bool:
        """Return whether a position (3,), ENU, m, is more than 1 m below the terrain.

        With far terrain, the terrain at the position counts. Without it, or where the map has no
        height, the position must be more than 1 m below `min_elevation`, the minimum elevation of
        the map, m.
        """
        if self.far_terrain is not None:
            clearance = float(self.far_terrain.clearance(position))
            if np.isfinite(clearance):
                return clearance < -1.0
        return bool(self.height(position) < min_elevation - 1.0)

    def height(self, position: Array) -> Array:
        """Return heights (...,), m, of positions (..., 3), ENU, above the datum.

        The datum is the sphere through the origin, or the plane z = 0 for flat terrain.
        """
        return position[..., 2] if self.moon is None else self.moon.height(position)
