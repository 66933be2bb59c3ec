"""Detection of failed thrusters from the measured rotation.

In each period the gyroscopes measure the angular impulse, and the commands predict it. A Kalman
filter estimates an effectiveness e of each thruster and a steady torque b:

    H = sum_j e_j tau_j t_j + (engine) + b T,

with the initial value e_j = 1 and process noise on all e_j, so that failures in flight are also
detected. A thruster is declared failed if its effectiveness is below 0.5 by three standard
deviations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SPREAD = 0.5  # initial standard deviation of an effectiveness
_WANDER = 0.004  # its process noise per period
_HALF, _SURE = 0.5, 3.0  # threshold of effectiveness, and confidence in standard deviations
_GYRO = 2e-4  # noise of the angular rate from one sample, rad/s
_RATIO = 0.05  # relative error of a predicted impulse: inertia, rise and decay of pulses
_STEADY = 0.02  # initial standard deviation of the steady angular acceleration, rad/s^2
_DRIFT = 0.001  # its process noise per period, rad/s^2


class ThrusterWatch:
    """Estimate the effectiveness of thrusters from gyroscope data.

    Parameters
    ----------
    count
        Number of thrusters.

    Attributes
    ----------
    effectiveness
        Estimates (n,): 1 for nominal, 0 for no thrust.
    failed
        Indices of the failed thrusters, in order of detection.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._x = np.concatenate((np.ones(count), np.zeros(3)))
        self._p = np.diag(np.repeat([_SPREAD**2, _STEADY**2], (count, 3)))
        self.failed: list[int] = []

    @property
    def effectiveness(self) -> Array:
        """Estimated effectiveness (n,)."""
        return self._x[: self.count].copy()

    @property
    def sigma(self) -> Array:
        """Standard deviations of the estimates (n,)."""
        return np.asarray(np.sqrt(np.diag(self._p)[: self.count]))

    def see(self, change: Array, known: Array, turns: Array, period: float) -> list[int]:
        """Update the estimates with one period; return the newly failed thrusters.

        Parameters
        ----------
        change
            Change of the angular rate over the period (3,), rad/s.
        known
            Predicted rate change by the engine (3,), rad/s.
        turns
            Predicted rate change by each thruster (n, 3), rad/s.
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
        """Limit the variance of unused thrusters to its initial value."""
        n = self.count
        over = np.sqrt(np.diag(self._p)[:n]) / _SPREAD
        shrink = np.ones(n + 3)
        shrink[:n] = 1.0 / np.maximum(over, 1.0)
        self._p *= shrink[:, None] * shrink[None, :]
