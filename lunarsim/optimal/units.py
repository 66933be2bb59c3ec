"""Units in which the numbers of a program are about 1."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Units:
    """What one is: m, s, kg."""

    length: float
    time: float
    mass: float

    @property
    def speed(self) -> float:
        """m/s."""
        return self.length / self.time

    @property
    def force(self) -> float:
        """N."""
        return self.mass * self.length / self.time**2
