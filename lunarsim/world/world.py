"""The truth that sensors look at."""

from __future__ import annotations

from dataclasses import dataclass, field

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
        Downward acceleration, m/s^2; uniform, since a descent spans a kilometre.
    light
        The Sun and the ground's photometry; only cameras look at it.
    """

    terrain: Terrain
    gravity: float
    light: Light = field(default_factory=Light)
