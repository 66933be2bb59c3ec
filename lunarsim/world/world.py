"""The truth that sensors look at."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.gravity import CentralGravity
from lunarsim.world.light import Light
from lunarsim.world.terrain import Terrain


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
    light
        The Sun and the ground's photometry; only cameras look at it.
    """

    terrain: Terrain
    gravity: float
    light: Light = field(default_factory=Light)
    moon: CentralGravity | None = None

    def height(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return heights (...,) over the level of the origin, m, of positions (..., 3)."""
        return position[..., 2] if self.moon is None else self.moon.height(position)
