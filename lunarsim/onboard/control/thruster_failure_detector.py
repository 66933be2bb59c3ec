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

from lunarsim.typing import Array

_INITIAL_SIGMA = 0.5  # initial standard deviation of an effectiveness
_PROCESS_SIGMA = 0.004  # process noise of an effectiveness per period
_FAILURE_THRESHOLD, _CONFIDENCE_SIGMAS = (
    0.5,
    3.0,
)  # threshold of effectiveness, and confidence in standard deviations
_RATE_NOISE_RAD_S = 2e-4  # noise of the angular rate from one sample, rad/s
_IMPULSE_RELATIVE_ERROR = (
    0.05  # relative error of a predicted impulse: inertia, rise and decay of pulses
)
_INITIAL_DISTURBANCE_RAD_S2 = (
    0.02  # initial standard deviation of the steady angular acceleration, rad/s^2
)
_DISTURBANCE_PROCESS_RAD_S2 = 0.001  # process noise of that acceleration, rad/s^2


class ThrusterFailureDetector:
    """Kalman filter that detects failed thrusters from gyroscope data.

    The filter estimates the effectiveness of each thruster: 1 for nominal thrust, 0 for none.

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
        self._p = np.diag(
            np.repeat([_INITIAL_SIGMA**2, _INITIAL_DISTURBANCE_RAD_S2**2], (count, 3))
        )
        self.failed: list[int] = []

    @property
    def effectiveness(self) -> Array:
        """Estimated effectiveness of each thruster (n,): 1 nominal, 0 no thrust."""
        return self._x[: self.count].copy()

    @property
    def sigma(self) -> Array:
        """Standard deviations of the estimated effectiveness (n,)."""
        return np.asarray(np.sqrt(np.diag(self._p)[: self.count]))

    def update(
        self, rate_change: Array, engine_change: Array, thruster_changes: Array, period: float
    ) -> list[int]:
        """Update the estimates with one period; return the newly failed thrusters.

        The result is a list of thruster indices, empty if no thruster failed.

        Parameters
        ----------
        rate_change
            Measured change of the angular rate over the period (3,), rad/s.
        engine_change
            Predicted rate change by the main engine (3,), rad/s.
        thruster_changes
            Predicted rate change by each thruster (n, 3), rad/s.
        period
            Duration of the period, s.
        """
        n = self.count
        self._p[np.arange(n), np.arange(n)] += _PROCESS_SIGMA**2
        steady = np.arange(n, n + 3)
        self._p[steady, steady] += _DISTURBANCE_PROCESS_RAD_S2**2
        h = np.hstack((thruster_changes.T, period * np.eye(3)))
        expected = np.abs(thruster_changes).sum(axis=0)
        noise = np.diag(2.0 * _RATE_NOISE_RAD_S**2 + (_IMPULSE_RELATIVE_ERROR * expected) ** 2)
        gain = self._p @ h.T @ np.linalg.inv(h @ self._p @ h.T + noise)
        self._x += gain @ (rate_change - engine_change - h @ self._x)
        self._p -= gain @ h @ self._p
        self._p = 0.5 * (self._p + self._p.T)
        self._limit_variance()
        low = self._x[:n] + _CONFIDENCE_SIGMAS * self.sigma < _FAILURE_THRESHOLD
        new = [int(j) for j in np.flatnonzero(low) if int(j) not in self.failed]
        self.failed += new
        return new

    def _limit_variance(self) -> None:
        """Limit the variance of each thruster's effectiveness to its initial value.

        Otherwise the process noise of unused thrusters would accumulate.
        """
        n = self.count
        over = np.sqrt(np.diag(self._p)[:n]) / _INITIAL_SIGMA
        shrink = np.ones(n + 3)
        shrink[:n] = 1.0 / np.maximum(over, 1.0)
        self._p *= shrink[:, None] * shrink[None, :]
