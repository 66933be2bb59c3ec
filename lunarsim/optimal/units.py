"""Scales that make the variables of a program about 1."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Units:
    """Scales of length (m), time (s) and mass (kg) for a descent's variables."""

    length: float
    time: float
    mass: float

    @property
    def speed(self) -> float:
        """Scale of velocity, m/s."""
        return self.length / self.time

    @property
    def force(self) -> float:
        """Scale of force, N."""
        return self.mass * self.length / self.time**2
