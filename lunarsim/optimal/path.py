"""Optimal path: states at any time, and violation of its constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.optimal.problem import Descent
from lunarsim.typing import Array


@dataclass(frozen=True)
class OptimalPath:
    """Descent path of N intervals, in each of which thrust over mass is constant.

    Attributes
    ----------
    descent
        Landing problem that the path solves.
    duration
        Final time, s.
    position, velocity
        Position and velocity at the nodes (N + 1, 3), ENU, m and m/s.
    mass
        Mass at the nodes (N + 1,), kg.
    thrust_acceleration
        Thrust over mass in each interval (N, 3), m/s^2.
    bound
        Relaxed magnitude of the thrust over mass (N,), m/s^2; equal to the magnitude of
        `thrust_acceleration` if the relaxation is lossless.
    delta_v
        Delta-v: integral of `bound`, m/s.
    cost
        Minimised quantity: delta-v plus penalty on thrust slack, m/s, or the landing error, m.
    slope
        Derivative of the minimum cost with respect to the final time, m/s^2 or m/s; zero at the
        optimum.
    hamiltonian
        Minus the derivative of the cost with respect to the length of each interval (N,), in the
        unit of `slope`.
    primer_vector
        Multipliers of the thrust in each interval (N, 3); parallel to the thrust if the tilt limit
        is not active.
    half_space_multipliers
        Multipliers of the half-spaces (N - 2, planes), in any unit; positive if active.
    curvature
        Second derivative of the minimum cost with respect to the final time, from a search; 0:
        unknown.
    converged
        Whether the search for the final time converged; False if its solves ran out, so that
        another final time may cost less. True without a search.
    solves, iterations, solver
        Number of solves and iterations, and name of the solver.
    """

    descent: Descent
    duration: float
    position: Array
    velocity: Array
    mass: Array
    thrust_acceleration: Array
    bound: Array
    delta_v: float
    cost: float
    slope: float
    hamiltonian: Array
    primer_vector: Array
    half_space_multipliers: Array
    curvature: float = 0.0
    converged: bool = True
    solves: int = 1
    iterations: int = 0
    solver: str = ""

    @property
    def intervals(self) -> int:
        """Number of intervals, N."""
        return len(self.bound)

    @property
    def step(self) -> float:
        """Length of one interval, s."""
        return self.duration / self.intervals

    @property
    def times(self) -> Array:
        """Times of the nodes (N + 1,), s."""
        return np.linspace(0.0, self.duration, self.intervals + 1)

    @property
    def propellant(self) -> float:
        """Propellant used, kg."""
        return self.descent.propellant_used(self.delta_v)

    @property
    def miss(self) -> float:
        """Landing error: distance of the path's end from the target, m."""
        return float(np.linalg.norm(self.position[-1] - self.descent.end_position))

    @property
    def log_mass(self) -> Array:
        """ln(mass / initial mass) at the interval centres (N,), dimensionless."""
        z = np.log(self.mass / self.mass[0])
        return np.asarray(0.5 * (z[1:] + z[:-1]))

    @property
    def forces(self) -> Array:
        """Thrust magnitude at the interval centres (N,), newtons."""
        size = np.linalg.norm(self.thrust_acceleration, axis=1)
        return np.asarray(self.descent.mass * np.exp(self.log_mass) * size)

    @property
    def loss(self) -> float:
        """Maximum relative excess of the relaxed over the true thrust magnitude.

        The excess is 0 if the convex relaxation is lossless.
        """
        size = np.linalg.norm(self.thrust_acceleration, axis=1)
        return float((self.bound / np.maximum(size, 1e-12)).max() - 1.0)

    @property
    def excess(self) -> float:
        """Maximum violation of the thrust limits, as a fraction of the maximum thrust."""
        d, f = self.descent, self.forces
        return float(
            max((f - d.thrust_max - d.thrust_slack).max(), (d.thrust_min - f).max()) / d.thrust_max
        )

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return position, velocity and thrust over mass (..., 3) at times `t` (...), s.

        Units are m, m/s and m/s^2; the frame is ENU.

        Times outside the path extrapolate the first or the last interval.
        """
        t = np.asarray(t, dtype=np.float64)
        k = np.clip((t / self.step).astype(np.int64), 0, self.intervals - 1)
        left = (t - k * self.step)[..., None]
        push = self.thrust_acceleration[k]
        a = push - np.array([0.0, 0.0, self.descent.gravity])
        v = self.velocity[k] + left * a
        return self.position[k] + left * (self.velocity[k] + 0.5 * left * a), v, push

    def mass_at(self, t: ArrayLike) -> Array:
        """Return the mass (...) at times `t` (...), kg."""
        t = np.asarray(t, dtype=np.float64)
        k = np.clip((t / self.step).astype(np.int64), 0, self.intervals - 1)
        log_ratio = (t - k * self.step) * self.bound[k] / self.descent.exhaust_velocity
        return np.asarray(self.mass[k] * np.exp(-log_ratio))
