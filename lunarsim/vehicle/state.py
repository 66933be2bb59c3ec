"""The true state of the lander."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.typing import Array


@dataclass(frozen=True)
class State:
    """True rigid-body state of the lander, with mass and thrust.

    Attributes
    ----------
    position
        Centre of mass, ENU (3,), m.
    velocity
        Velocity of the centre of mass, ENU (3,), m/s.
    attitude
        Unit quaternion, scalar last, body to ENU (4,).
    rate
        Angular velocity of the body, body axes (3,), rad/s.
    mass
        Total mass, kg.
    thrust
        Current thrust of the engine, N.
    """

    position: Array
    velocity: Array
    attitude: Array
    rate: Array
    mass: float
    thrust: float = 0.0

    def as_vector(self) -> Array:
        """Return the state as one array (15,), in the order of the attributes."""
        return np.concatenate(
            (self.position, self.velocity, self.attitude, self.rate, [self.mass, self.thrust])
        )

    @classmethod
    def from_vector(cls, y: Array) -> State:
        """Build a state from an array (15,) in the order of the attributes."""
        return cls(
            y[0:3].copy(),
            y[3:6].copy(),
            y[6:10].copy(),
            y[10:13].copy(),
            float(y[13]),
            float(y[14]),
        )
