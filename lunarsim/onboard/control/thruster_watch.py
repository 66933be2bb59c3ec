"""A thruster that does not push is noticed by what turns, and left out of the allocation.

Each period the gyroscopes tell what angular impulse the lander has had; what it should have had
follows from the orders. A Kalman filter keeps an effectiveness e of each thruster, and a steady
torque b besides:

    H = sum_j e_j tau_j t_j + (engine) + b T,

with e_j = 1 at first and all free to wander, so that a valve that fails in flight is seen as well.
A thruster is given up once its effectiveness is below a half by three standard deviations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SPREAD = 0.5  # of an effectiveness before anything is known
_WANDER = 0.004  # of it in a period
_HALF, _SURE = 0.5, 3.0
_GYRO = 2e-4  # of a rate told by one sample, rad/s
_RATIO = 0.05  # of an expected impulse: moments of inertia, pulses that rise and decay
_STEADY = 0.02  # steady angular acceleration before anything is known, rad/s^2
_DRIFT = 0.001  # of it in a period


class ThrusterWatch:
    """Effectiveness of thrusters by what the gyroscopes tell.

    Parameters
    ----------
    count
        Of the thrusters.

    Attributes
    ----------
    effectiveness
        Estimates (n,): 1 pushes, 0 does not.
    failed
        Numbers of those that were given up, in the order of it.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._x = np.concatenate((np.ones(count), np.zeros(3)))
        self._p = np.diag(np.repeat([_SPREAD**2, _STEADY**2], (count, 3)))
        self.failed: list[int] = []

    @property
    def effectiveness(self) -> Array:
        """Estimates (n,)."""
        return self._x[: self.count].copy()

    @property
    def sigma(self) -> Array:
        """Standard deviations of the estimates (n,)."""
        return np.asarray(np.sqrt(np.diag(self._p)[: self.count]))

    def see(self, change: Array, known: Array, turns: Array, period: float) -> list[int]:
        """Take in a period; return the thrusters that are given up now.

        Parameters
        ----------
        change
            Of the rate over the period (3,), rad/s.
        known
            What of it the engine was to do (3,), rad/s.
        turns
            What each thruster was ordered to do (n, 3), rad/s.
        period
            s.
        """
        n = self.count
        self._p[np.arange(n), np.arange(n)] += _WANDER**2
        steady = np.arange(n, n + 3)
        self._p[steady, steady] += _DRIFT**2
        h = np.hstack((turns.T, period * np.eye(3)))
        expected = np.abs(turns).sum(axis=0)
        noise = np.diag(2.0 * _GYRO**2 + (_RATIO * expected) ** 2)
        gain = self._p @ h.T @ np.linalg.inv(h @ self._p @ h.T + noise)
        self._x += gain @ (change - known - h @ self._x)
        self._p -= gain @ h @ self._p
        self._p = 0.5 * (self._p + self._p.T)
        self._held()
        low = self._x[:n] + _SURE * self.sigma < _HALF
        new = [int(j) for j in np.flatnonzero(low) if int(j) not in self.failed]
        self.failed += new
        return new

    def _held(self) -> None:
        """Keep what is not seen for long from growing beyond what is known of any thruster."""
        n = self.count
        over = np.sqrt(np.diag(self._p)[:n]) / _SPREAD
        shrink = np.ones(n + 3)
        shrink[:n] = 1.0 / np.maximum(over, 1.0)
        self._p *= shrink[:, None] * shrink[None, :]
