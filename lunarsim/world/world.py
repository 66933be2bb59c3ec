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
        Terrain beyond the map on the spherical Moon; None: rays that leave the map hit nothing.
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

    def cast(self, origin: ArrayLike, direction: ArrayLike, max_range: float = np.inf) -> RayHits:
        """Intersect rays with the map; if they miss the map, with the far terrain.

        `origin` (3,), ENU, m, is the start of the rays, `direction` (n, 3) their unit vectors and
        `max_range` the maximum range, m. Returns range, normal and rock index of each first hit. A
        ray that hits neither has NaN and the index -2.
        """
        hits = self.terrain.cast(origin, direction, max_range)
        if self.far_terrain is None or np.isfinite(hits.range).all():
            return hits
        beyond = self.far_terrain.cast(origin, direction, max_range)
        missed = ~np.isfinite(hits.range)
        return RayHits(
            np.where(missed, beyond.range, hits.range),
            np.where(missed[:, None], beyond.normal, hits.normal),
            np.where(missed, beyond.rock, hits.rock),
        )

    def is_below_terrain(self, position: Array, min_elevation: float) -> bool:
        """Return whether a position (3,), ENU, m, is more than 1 m below the terrain.

        With far terrain, the terrain at the position counts. Without it, the position must be more
        than 1 m below `min_elevation`, the minimum elevation of the map, m.
        """
        if self.far_terrain is not None:
            return bool(self.far_terrain.clearance(position) < -1.0)
        return bool(self.height(position) < min_elevation - 1.0)

    def height(self, position: Array) -> Array:
        """Return heights (...,), m, of positions (..., 3), ENU, above the datum.

        The datum is the sphere through the origin, or the plane z = 0 for flat terrain.
        """
        return position[..., 2] if self.moon is None else self.moon.height(position)
