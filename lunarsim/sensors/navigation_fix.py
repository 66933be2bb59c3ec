"""Navigation fixes generated from an error budget: truth plus errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.measurements import NavigationFix
from lunarsim.models.instruments import NavigationFixInstrument
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World


@dataclass(frozen=True)
class NavigationFixErrors:
    """Settings of an external navigation system, described by its error budget.

    The system measures ("fixes") position, velocity and attitude.

    Attributes
    ----------
    position_bias
        Standard deviation of the position error that is constant over a flight, m.
    position_drift, drift_time
        Standard deviation of the Gauss-Markov position drift, m, and its time constant, s. The
        drift is zero at the first fix and grows to this standard deviation.
    velocity
        Standard deviation of the Gauss-Markov velocity error with the same time constant, m/s.
    attitude
        Standard deviation of the misalignment that is constant over a flight, rad.
    """

    position_bias: float = quantity(
        5.0, "m", ge=0, help="position error that is constant during a flight, 1 sigma per axis"
    )
    position_drift: float = quantity(
        0.1,
        "m",
        ge=0,
        help="position error that drifts during a flight (Gauss-Markov process), 1 sigma per axis",
    )
    drift_time: float = quantity(
        60.0,
        "s",
        gt=0,
        help="time constant of the drifting errors of position and velocity (Gauss-Markov "
        "processes)",
    )
    velocity: float = quantity(
        0.02,
        "m/s",
        ge=0,
        help="velocity error that drifts during a flight (Gauss-Markov process), 1 sigma per axis",
    )
    attitude: float = quantity(
        0.03, "deg", ge=0, help="attitude error that is constant during a flight, 1 sigma per axis"
    )

    measurement_type: ClassVar[type] = NavigationFix
    is_tasked: ClassVar[bool] = False

    def build(self, rng: np.random.Generator, step: float) -> NavigationFixSource:
        """Return the simulated system of one flight; constant errors come from `rng`."""
        return NavigationFixSource(self, rng)

    def calibration(self) -> NavigationFixInstrument:
        """Return the empty calibration, because every fix includes its covariance."""
        return NavigationFixInstrument()

    def __post_init__(self) -> None:
        check_bounds(self, "navigation")


class NavigationFixSource:
    """Simulated external navigation system of one flight: true state plus errors.

    Hazard maps use the estimated frame, so that the constant position error displaces map and
    lander together. Only the drift since a scan displaces the touchdown on the map.

    Parameters
    ----------
    budget
        Standard deviations of the errors.
    rng
        Source of the constant errors of this flight; pass the same generator to `measure`.
    """

    def __init__(self, budget: NavigationFixErrors, rng: np.random.Generator) -> None:
        self.budget = budget
        self._bias = budget.position_bias * rng.standard_normal(3)
        self._misalignment = quat_from_rotation_vector(budget.attitude * rng.standard_normal(3))
        self._drift = np.zeros(3)
        self._velocity = budget.velocity * rng.standard_normal(3)
        # Variance of the drift over its final variance.
        self._drift_variance_ratio = 0.0
        self._time: float | None = None

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> NavigationFix:
        """Return the true position, velocity and attitude plus errors.

        `state` is the true state at `time`, s, which must not decrease between calls; `rng` is the
        source of the drift. `world` and `mount` are not used.
        """
        b = self.budget
        if self._time is not None and time > self._time:
            keep = np.exp(-(time - self._time) / b.drift_time)
            spread = np.sqrt(1.0 - keep * keep)
            noise = rng.standard_normal((2, 3))
            self._drift = keep * self._drift + b.position_drift * spread * noise[0]
            self._velocity = keep * self._velocity + b.velocity * spread * noise[1]
            self._drift_variance_ratio = keep * keep * self._drift_variance_ratio + spread * spread
        self._time = time
        return NavigationFix(
            time,
            state.position + self._bias + self._drift,
            state.velocity + self._velocity,
            quat_multiply(self._misalignment, state.attitude),
            self._covariance(),
        )

    def _covariance(self) -> Array:
        b = self.budget
        position = b.position_bias**2 + b.position_drift**2 * self._drift_variance_ratio
        return np.diag(np.repeat([position, b.velocity**2, b.attitude**2], 3))
