"""The contract of guidance laws."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Target:
    """Where a phase of flight ends.

    Attributes
    ----------
    position
        Estimated ENU (3,), m.
    velocity, acceleration
        Wanted there (3,), m/s and m/s^2.
    """

    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    acceleration: Array = field(default_factory=lambda: np.zeros(3))


class GuidanceLaw(Protocol):
    """Anything that turns an estimate and a target into a thrust acceleration."""

    def command(self, estimate: Estimate, target: Target, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2 (gravity already made up for)."""
        ...
