"""Gravity as a mission knows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError


class GravityModel(Protocol):
    """Acceleration by position."""

    def at(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return the acceleration (3,), ENU, m/s^2, at a position (3,), m."""
        ...


@dataclass(frozen=True)
class UniformGravity:
    """The same everywhere: a descent spans a kilometre.

    Attributes
    ----------
    magnitude
        Downward acceleration, m/s^2.

    Examples
    --------
    >>> UniformGravity(1.622).at([0.0, 0.0, 100.0])
    array([ 0.   ,  0.   , -1.622])
    """

    magnitude: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.magnitude) and self.magnitude > 0.0):
            raise InputError("gravity_m_s2", self.magnitude, "a positive number in m/s^2")

    def at(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return the acceleration (3,), ENU, m/s^2."""
        return np.array([0.0, 0.0, -self.magnitude])
