"""Initial guess of a rigid body's path from the optimum of a point mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.six_dof.path import RigidPath
from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.typing import Array


@dataclass(frozen=True)
class InitialGuess:
    """First guess of a rigid body's descent for a solver.

    States and commands need not be consistent with each other.

    Attributes
    ----------
    duration
        Final time, s.
    states
        States at N + 1 nodes (N + 1, 15): position, velocity, attitude, rate, mass and thrust.
    thrust, torque
        Commands in N intervals: thrust (N,), N, and torque (N, 3), N m.
    """

    duration: float
    states: Array
    thrust: Array
    torque: Array

    def resample(self, intervals: int) -> InitialGuess:
        """Return the guess with another number of intervals."""
        count = len(self.thrust)
        if count == intervals:
            return self
        old, new = (np.linspace(0.0, 1.0, n + 1) for n in (count, intervals))
        states = np.column_stack([np.interp(new, old, column) for column in self.states.T])
        states[:, 6:10] /= np.linalg.norm(states[:, 6:10], axis=1, keepdims=True)
        of = np.minimum((0.5 * (new[1:] + new[:-1]) * count).astype(np.int64), count - 1)
        return InitialGuess(self.duration, states, self.thrust[of], self.torque[of])


def initial_guess(descent: RigidDescent, intervals: int) -> InitialGuess:
    """Return a guess from the minimum-propellant path of a point mass.

    Body z is along the thrust, and yaw is that of the start. Rates and torques are differences of
    the attitude. `intervals` is the number of intervals of the guess.

    Raises
    ------
    InfeasibleError
        If a point mass cannot land.
    SolverError
        If the solver for the point mass fails.
    """
    d = descent
    path = minimize_propellant(Planner(intervals), d.as_point(), allow_lossy=True)
    n, step = intervals, path.step
    states = np.zeros((n + 1, 15))
    states[:, :3], states[:, 3:6], states[:, 13] = path.position, path.velocity, path.mass
    push = path.thrust_acceleration
    thrust_direction = np.vstack((push[:1], 0.5 * (push[1:] + push[:-1]), [[0, 0, 1.0]]))
    turns = _align_with_thrust(thrust_direction, Rotation.from_quat(d.start.attitude))
    states[:, 6:10] = _make_continuous(turns.as_quat())
    away = (turns[:-1].inv() * turns[1:]).as_rotvec() / step
    rates = np.vstack((d.start.rate, 0.5 * (away[1:] + away[:-1]), np.zeros(3)))
    states[:, 10:13] = rates
    states[0, 6:10] = d.start.attitude
    if states[0, 6:10] @ states[1, 6:10] < 0.0:
        states[1:, 6:10] *= -1.0
    states[:, 14] = np.append(path.forces, path.forces[-1])
    states[0, 14] = d.start.thrust
    moments = np.array([d.lander.inertia(m) for m in path.mass[:-1]])
    torque = np.clip(moments * np.diff(rates, axis=0) / step, -d.torques, d.torques)
    thrust = np.clip(path.forces, d.min_thrust_command, d.max_thrust_command)
    return InitialGuess(path.duration, states, thrust, torque)


def remaining_guess(path: RigidPath, elapsed: float) -> InitialGuess:
    """Return the part of a path after `elapsed` s as an initial guess.

    It is divided into the same number of intervals as the complete path.

    Raises
    ------
    InputError
        If `elapsed` is negative, or at least the duration of the path.
    """
    n, left = len(path.thrust), path.duration - elapsed
    if not 0.0 <= elapsed < path.duration:
        raise InputError(
            "optimal.elapsed",
            elapsed,
            f"must be 0 or more and less than the duration of the path, {path.duration:.1f} s",
        )
    old = np.linspace(0.0, path.duration, n + 1)
    new = np.linspace(elapsed, path.duration, n + 1)
    states = np.column_stack([np.interp(new, old, column) for column in path.states.T])
    states[:, 6:10] /= np.linalg.norm(states[:, 6:10], axis=1, keepdims=True)
    of = np.clip(np.searchsorted(old, 0.5 * (new[1:] + new[:-1])) - 1, 0, n - 1)
    return InitialGuess(left, states, path.thrust[of], path.torque[of])


def _align_with_thrust(thrust_direction: Array, start: Rotation) -> Rotation:
    """Return attitudes with body z along vectors (K, 3) and the initial yaw.

    The first attitude is `start` itself.
    """
    up = thrust_direction / np.linalg.norm(thrust_direction, axis=1, keepdims=True)
    heading = start.apply([1.0, 0.0, 0.0])
    y = np.cross(up, heading)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    matrices = np.stack((np.cross(y, up), y, up), axis=2)
    matrices[0] = start.as_matrix()
    return Rotation.from_matrix(matrices)


def _make_continuous(quaternions: Array) -> Array:
    """Choose quaternion signs so that consecutive quaternions are near each other."""
    signs = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(quaternions * np.concatenate(([1.0], np.cumprod(signs)))[:, None])
