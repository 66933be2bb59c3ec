"""The true environment that the sensors observe."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.models.gravity import CentralGravity
from lunarsim.world.far_terrain import FarTerrain
from lunarsim.world.light import Light
from lunarsim.world.terrain import RayHits, Terrain


@dataclass(frozen=True)
class World:
    """Collect the true environment of a flight.

    Attributes
    ----------
    terrain
        True terrain of the map area.
    gravity
        Uniform downward acceleration, m/s^2; used only if `moon` is None.
    moon
        Spherical Moon with central gravity, for descents from orbit; None: flat terrain and uniform
        gravity.
    surroundings
        Terrain beyond the map on the spherical Moon; None: rays that leave the map hit nothing.
    light
        Sun, Earth and photometry of the terrain; only cameras use it.
    """

    terrain: Terrain
    gravity: float
    light: Light = field(default_factory=Light)
    moon: CentralGravity | None = None
    surroundings: FarTerrain | None = None

    def cast(self, origin: ArrayLike, direction: ArrayLike, max_range: float = np.inf) -> RayHits:
        """Cast rays onto the map, then those that miss onto the far terrain.

        Parameters and results are those of `Terrain.cast`.
        """
        hits = self.terrain.cast(origin, direction, max_range)
        if self.surroundings is None or np.isfinite(hits.range).all():
            return hits
        beyond = self.surroundings.cast(origin, direction, max_range)
        missed = ~np.isfinite(hits.range)
        return RayHits(
            np.where(missed, beyond.range, hits.range),
            np.where(missed[:, None], beyond.normal, hits.normal),
            np.where(missed, beyond.rock, hits.rock),
        )

    def under(self, position: NDArray[np.float64], low: float) -> bool:
        """Return whether a position (3,) is over 1 m below the terrain."""
        if self.surroundings is not None:
            return bool(self.surroundings.clearance(position) < -1.0)
        return bool(self.height(position) < low - 1.0)

    def height(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return heights (...,) of positions (..., 3) above the datum of the origin, m."""
        return position[..., 2] if self.moon is None else self.moon.height(position)
