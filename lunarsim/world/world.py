"""The truth that sensors look at."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.models.gravity import CentralGravity
from lunarsim.world.light import Light
from lunarsim.world.surroundings import Surrounded
from lunarsim.world.terrain import RayHits, Terrain


@dataclass(frozen=True)
class World:
    """Everything that is true and not the lander.

    Attributes
    ----------
    terrain
        The ground.
    gravity
        Downward acceleration, m/s^2; uniform, since a descent spans a kilometre, but for a `moon`.
    moon
        Round ground and central gravity, for descents from orbit; None: level and uniform.
    surroundings
        Ground beyond the map, on such a Moon; None: nothing is seen there.
    light
        The Sun and the ground's photometry; only cameras look at it.
    """

    terrain: Terrain
    gravity: float
    light: Light = field(default_factory=Light)
    moon: CentralGravity | None = None
    surroundings: Surrounded | None = None

    def cast(self, origin: ArrayLike, direction: ArrayLike, max_range: float = np.inf) -> RayHits:
        """Cast rays onto the map, and where they miss it onto what lies about it.

        See `Terrain.cast`.
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
        """Tell whether a position (3,) is a metre under all ground, whose least height is `low`."""
        if self.surroundings is not None:
            return bool(self.surroundings.clearance(position) < -1.0)
        return bool(self.height(position) < low - 1.0)

    def height(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return heights (...,) over the level of the origin, m, of positions (..., 3)."""
        return position[..., 2] if self.moon is None else self.moon.height(position)
