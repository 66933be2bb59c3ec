"""Fixes of a navigation system that is known by its error budget alone: truth plus errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.measurements import NavigationFix
from lunarsim.vehicle.state import State
from lunarsim.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ErrorBudget:
    """Standard deviations, each an axis.

    Attributes
    ----------
    position_bias
        Constant offset of a flight from the map, m.
    position_drift, drift_time
        Gauss-Markov drift after the start, m, and its time constant, s.
    velocity
        Gauss-Markov velocity error with the same time constant, m/s.
    attitude
        Constant misalignment of a flight, rad.
    """

    position_bias: float = 5.0
    position_drift: float = 0.1
    drift_time: float = 60.0
    velocity: float = 0.02
    attitude: float = np.deg2rad(0.03)

    def __post_init__(self) -> None:
        for name in ("position_bias", "position_drift", "velocity", "attitude"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"navigation.{name}", value, "0 or a positive number")
        if not self.drift_time > 0.0:
            raise InputError("navigation.drift_time", self.drift_time, "a positive time")


class FixInstrument:
    """Gives the true state with errors of a known budget.

    The hazard map is drawn in the estimated frame, so the constant bias moves map and lander
    together; the drift since a scan is what misplaces the touchdown on the map.

    Parameters
    ----------
    budget
        Standard deviations of the errors.
    rng
        Source of the constant errors of this flight; `measure` is to be given the same one.
    """

    def __init__(self, budget: ErrorBudget, rng: np.random.Generator) -> None:
        self.budget = budget
        self._bias = budget.position_bias * rng.standard_normal(3)
        self._misalignment = quat_from_rotation_vector(budget.attitude * rng.standard_normal(3))
        self._drift = np.zeros(3)
        self._velocity = budget.velocity * rng.standard_normal(3)
        self._time: float | None = None
        variances = np.repeat(
            [
                budget.position_bias**2 + budget.position_drift**2,
                budget.velocity**2,
                budget.attitude**2,
            ],
            3,
        )
        self._covariance = np.diag(variances)

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> NavigationFix:
        """Return truth plus error at `time`, which must not run backwards."""
        b = self.budget
        if self._time is not None and time > self._time:
            keep = np.exp(-(time - self._time) / b.drift_time)
            spread = np.sqrt(1.0 - keep * keep)
            noise = rng.standard_normal((2, 3))
            self._drift = keep * self._drift + b.position_drift * spread * noise[0]
            self._velocity = keep * self._velocity + b.velocity * spread * noise[1]
        self._time = time
        return NavigationFix(
            time,
            state.position + self._bias + self._drift,
            state.velocity + self._velocity,
            quat_multiply(self._misalignment, state.attitude),
            state.rate,
            self._covariance,
        )
