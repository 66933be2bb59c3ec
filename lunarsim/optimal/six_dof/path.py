"""A descent of a rigid body as it was solved for, and how well a flight keeps what was asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunarsim.optimal.six_dof.problem import RigidDescent

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RigidPath:
    """A descent in N intervals of held commands.

    Attributes
    ----------
    descent
        The problem.
    duration
        Final time, s.
    states
        At the nodes (N + 1, 15): position, velocity, attitude, rate, mass and thrust.
    thrust
        Asked in each interval (N,), N.
    torque
        In each interval (N, 3), N m.
    iterations
        Of the solver, or programs solved.
    seconds
        What it took, s.
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
        """Kg."""
        return float(self.states[0, 13] - self.states[-1, 13])


@dataclass(frozen=True)
class Kept:
    """By how much a flight keeps what was asked of it: worst over its course.

    Attributes
    ----------
    miss, speed
        Off the end asked for, m and m/s.
    lean, spin
        At the end, rad and rad/s.
    tilt, rate, slope, sight
        By how much limits are passed at most, rad, rad/s, m and rad; 0 or less: kept.
    """

    miss: float
    speed: float
    lean: float
    spin: float
    tilt: float
    rate: float
    slope: float
    sight: float


def kept(descent: RigidDescent, times: Array, states: Array) -> Kept:
    """Return how well states (K, 15) at times (K,), s, keep what a descent asks."""
    d = descent
    at, q = states[:, :3] - d.end_position, states[:, 6:10]
    up = 1.0 - 2.0 * (q[:, 0] ** 2 + q[:, 1] ** 2)
    tilt = np.arccos(np.clip(up, -1.0, 1.0))
    rate = np.linalg.norm(states[:, 10:13], axis=1)
    under = np.tan(d.glideslope or 0.0) * np.hypot(at[:, 0], at[:, 1]) - at[:, 2] - d.drop
    beside = -np.inf
    if d.sight is not None:
        seen = times <= d.sight.share * times[-1]
        beside = float(_off_axis(d.sight.axis, at[seen], q[seen]).max() - d.sight.half_angle)
    return Kept(
        miss=float(np.linalg.norm(at[-1])),
        speed=float(np.linalg.norm(states[-1, 3:6] - d.end_velocity)),
        lean=float(tilt[-1]),
        spin=float(rate[-1]),
        tilt=float(tilt.max() - d.max_tilt) if d.max_tilt is not None else -np.inf,
        rate=float(rate.max() - d.max_rate) if d.max_rate is not None else -np.inf,
        slope=float(under.max()) if d.glideslope is not None else -np.inf,
        sight=beside,
    )


def _off_axis(axis: Array, at: Array, q: Array) -> Array:
    """Return the angle between a body axis and the way to the site (K,), rad."""
    turned = Rotation.from_quat(q).apply(axis)
    cosine = -(turned * at).sum(axis=1) / np.maximum(np.linalg.norm(at, axis=1), 1e-9)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
