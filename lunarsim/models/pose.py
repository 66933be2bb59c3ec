"""Interface of poses (position and attitude of a lander) for sensor models."""

from __future__ import annotations

from typing import Protocol

from lunarsim.typing import Array


class Pose(Protocol):
    """Interface of objects with a position and an attitude, true or estimated."""

    @property
    def position(self) -> Array:
        """Position, ENU (3,), m."""
        ...

    @property
    def attitude(self) -> Array:
        """Attitude as a unit quaternion, scalar last, body to ENU (4,)."""
        ...
