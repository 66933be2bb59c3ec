"""A path as it was solved for: what it does at any time, and how well it keeps what was asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.optimal.problem import Descent

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Path:
    """A descent in N intervals of constant thrust over mass.

    Attributes
    ----------
    descent
        The problem.
    duration
        Final time, s.
    position, velocity
        At the nodes (N + 1, 3), m and m/s.
    mass
        At the nodes (N + 1,), kg.
    thrust
        Thrust over mass (N, 3), m/s^2.
    bound
        What the program takes for its size (N,): the same where nothing was lost by relaxing.
    increment
        Integral of `bound`, m/s.
    cost
        What was made least: increment and the price of spare thrust, m/s, or the landing error, m.
    slope
        Derivative of the least cost with the final time, m/s^2 or m/s; zero at the best one.
    hamiltonian
        Minus the derivative with the length of each interval (N,), as `slope`.
    primer
        Multipliers of the thrust in each interval (N, 3), along it where tilt does not bind.
    bars
        Multipliers of the half-spaces (N - 2, planes), of any unit: more than 0 where one binds.
    curvature
        Second derivative of the least cost with the final time, as a search saw it; 0: not known.
    settled
        Whether a search for the best final time came to its end; False where its solves ran out, so
        that another final time may cost less. True where none was searched for.
    solves, iterations, solver
        What it took, and who gave the answer.
    """

    descent: Descent
    duration: float
    position: Array
    velocity: Array
    mass: Array
    thrust: Array
    bound: Array
    increment: float
    cost: float
    slope: float
    hamiltonian: Array
    primer: Array
    bars: Array
    curvature: float = 0.0
    settled: bool = True
    solves: int = 1
    iterations: int = 0
    solver: str = ""

    @property
    def intervals(self) -> int:
        """N."""
        return len(self.bound)

    @property
    def step(self) -> float:
        """Length of an interval, s."""
        return self.duration / self.intervals

    @property
    def times(self) -> Array:
        """Of the nodes (N + 1,), s."""
        return np.linspace(0.0, self.duration, self.intervals + 1)

    @property
    def propellant(self) -> float:
        """Kg."""
        return self.descent.burnt(self.increment)

    @property
    def miss(self) -> float:
        """How far from the place asked for it ends, m."""
        return float(np.linalg.norm(self.position[-1] - self.descent.end_position))

    @property
    def log_mass(self) -> Array:
        """ln(mass / mass at the start) in the middle of each interval (N,)."""
        z = np.log(self.mass / self.mass[0])
        return np.asarray(0.5 * (z[1:] + z[:-1]))

    @property
    def forces(self) -> Array:
        """Thrust in the middle of each interval (N,), N."""
        size = np.linalg.norm(self.thrust, axis=1)
        return np.asarray(self.descent.mass * np.exp(self.log_mass) * size)

    @property
    def loss(self) -> float:
        """By how much the bound exceeds the thrust at most, over the thrust: 0 if none is lost."""
        size = np.linalg.norm(self.thrust, axis=1)
        return float((self.bound / np.maximum(size, 1e-12)).max() - 1.0)

    @property
    def excess(self) -> float:
        """By how much the thrust breaks its limits at most, over the greatest thrust."""
        d, f = self.descent, self.forces
        return float(
            max((f - d.thrust_max - d.spare).max(), (d.thrust_min - f).max()) / d.thrust_max
        )

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return position, velocity and thrust over mass (..., 3) at times `t` (...), s.

        Before the start the first interval is carried on, after the end the last one.
        """
        t = np.asarray(t, dtype=np.float64)
        k = np.clip((t / self.step).astype(np.int64), 0, self.intervals - 1)
        left = (t - k * self.step)[..., None]
        push = self.thrust[k]
        a = push - np.array([0.0, 0.0, self.descent.gravity])
        v = self.velocity[k] + left * a
        return self.position[k] + left * (self.velocity[k] + 0.5 * left * a), v, push

    def mass_at(self, t: ArrayLike) -> Array:
        """Return the mass (...) at times `t` (...), kg."""
        t = np.asarray(t, dtype=np.float64)
        k = np.clip((t / self.step).astype(np.int64), 0, self.intervals - 1)
        burnt = (t - k * self.step) * self.bound[k] / self.descent.exhaust_velocity
        return np.asarray(self.mass[k] * np.exp(-burnt))
