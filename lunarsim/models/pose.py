"""Pose of a lander, as sensor models need it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Pose(Protocol):
    """Position and attitude, of the true state or of an estimate."""

    @property
    def position(self) -> Array:
        """ENU (3,), m."""
        ...

    @property
    def attitude(self) -> Array:
        """Quaternion, body to ENU (4,)."""
        ...
