"""The truth that sensors look at."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.terrain import Terrain


@dataclass(frozen=True)
class World:
    """Everything that is true and not the lander.

    Attributes
    ----------
    terrain
        The ground.
    gravity
        Downward acceleration, m/s^2; uniform, since a descent spans a kilometre.
    """

    terrain: Terrain
    gravity: float
