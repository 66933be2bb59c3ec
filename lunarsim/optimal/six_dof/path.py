"""Rigid-body path, and the errors and constraint violations of a flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.typing import Array


@dataclass(frozen=True)
class RigidPath:
    """Descent of a rigid body in N intervals of constant commands.

    Attributes
    ----------
    descent
        Landing problem that the path solves.
    duration
        Final time, s.
    states
        States at the nodes (N + 1, 15): position, velocity, attitude, rate, mass and thrust.
    thrust
        Commanded thrust in each interval (N,), N.
    torque
        Torque in each interval (N, 3), N m.
    iterations
        Iterations of the solver, or number of programs solved.
    seconds
        Computing time, s.
    """

    descent: RigidDescent
    duration: float
    states: Array
    thrust: Array
    torque: Array
    iterations: int
    seconds: float

    @property
    def propellant(self) -> float:
        """Propellant used, kg."""
        return float(self.states[0, 13] - self.states[-1, 13])


@dataclass(frozen=True)
class ConstraintViolations:
    """Final errors and maximum constraint violations of a flight.

    Attributes
    ----------
    miss, velocity
        Final errors of position and velocity, m and m/s.
    final_tilt, final_rate
        Final tilt and angular rate, rad and rad/s.
    tilt, rate, glideslope, sight
        Maximum violation of the limits of tilt (rad), angular rate (rad/s), glideslope (m) and line
        of sight (rad); 0 or less: satisfied; -inf: no such limit.
    """

    miss: float
    velocity: float
    final_tilt: float
    final_rate: float
    tilt: float
    rate: float
    glideslope: float
    sight: float


def evaluate_violations(descent: RigidDescent, times: Array, states: Array) -> ConstraintViolations:
    """Evaluate states (K, 15) at times (K,), s, against the requirements of a descent."""
    d = descent
    at, q = states[:, :3] - d.end_position, states[:, 6:10]
    up = 1.0 - 2.0 * (q[:, 0] ** 2 + q[:, 1] ** 2)
    tilt = np.arccos(np.clip(up, -1.0, 1.0))
    rate = np.linalg.norm(states[:, 10:13], axis=1)
    below_glideslope = (
        np.tan(d.glideslope or 0.0) * np.hypot(at[:, 0], at[:, 1]) - at[:, 2] - d.apex_depth
    )
    sight_violation = -np.inf
    if d.sight is not None:
        must_see = times <= d.sight.visible_fraction * times[-1]
        sight_violation = float(
            _angle_off_axis(d.sight.axis, at[must_see], q[must_see]).max() - d.sight.half_angle
        )
    return ConstraintViolations(
        miss=float(np.linalg.norm(at[-1])),
        velocity=float(np.linalg.norm(states[-1, 3:6] - d.end_velocity)),
        final_tilt=float(tilt[-1]),
        final_rate=float(rate[-1]),
        tilt=float(tilt.max() - d.max_tilt) if d.max_tilt is not None else -np.inf,
        rate=float(rate.max() - d.max_rate) if d.max_rate is not None else -np.inf,
        glideslope=float(below_glideslope.max()) if d.glideslope is not None else -np.inf,
        sight=sight_violation,
    )


def _angle_off_axis(axis: Array, offset: Array, attitude: Array) -> Array:
    """Return the angle between a body axis and the direction to the site (K,), rad.

    `offset` (K, 3) are positions relative to the site, and `attitude` (K, 4) quaternions.
    """
    turned = Rotation.from_quat(attitude).apply(axis)
    cosine = -(turned * offset).sum(axis=1) / np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
