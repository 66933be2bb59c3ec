"""Guidance along paths of one shape, with lag compensation and an open-loop end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lunarsim.core.feedback import compile_formula, evaluate_formula
from lunarsim.core.guidance import (
    COMMAND_TIME,
    COMMANDED,
    advance_response,
    predict_response,
)
from lunarsim.models.gravity import GravityModel
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.paths import PathShape, PolynomialPath
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite

# Maps position, velocity, end and time-to-go to the required acceleration, gravity included.
FeedbackLaw = Callable[[Array, Array, PhaseEnd, float], Array]


class CompiledFeedback:
    """Feedback law that evaluates a compiled formula (`PathLaw.formula`).

    Parameters
    ----------
    function
        Formula, a plain Python function; it is compiled once.
    gravity
        Downward acceleration, m/s^2.
    gains
        Parameters of the formula.
    """

    def __init__(self, function: Any, gravity: float, gains: tuple[float, ...] = ()) -> None:
        self.formula = compile_formula(function)
        self.gravity, self.gains = float(gravity), np.array(gains, dtype=np.float64)

    def __call__(self, position: Array, velocity: Array, end: PhaseEnd, time_to_go: float) -> Array:
        """Return the acceleration towards `end` (3,), m/s^2, gravity included.

        `position` and `velocity` (3,) are in m and m/s, `time_to_go` is in s.
        """
        out = np.empty(3)
        evaluate_formula(
            self.formula, np.array([position, velocity], dtype=np.float64),
            np.array(end.position, dtype=np.float64),
            np.array([end.velocity, end.acceleration], dtype=np.float64), float(time_to_go),
            self.gravity, self.gains, out,
        )  # fmt: skip
        return out


class ActuatorLagModel:
    """First-order model of the vehicle's response to acceleration commands.

    Parameters
    ----------
    lag
        Time constant of the response, s.
    """

    def __init__(self, lag: float) -> None:
        self.lag = lag
        self._response = np.zeros(7)
        self._response[COMMAND_TIME] = np.nan

    def advance(self, time: float) -> None:
        """Propagate the modelled acceleration of the vehicle to `time`, s.

        It approaches the last recorded command exponentially.
        """
        advance_response(self._response, time, self.lag)

    def record_command(self, acceleration: Array) -> None:
        """Store the commanded acceleration (3,), gravity included, m/s^2."""
        self._response[COMMANDED:COMMAND_TIME] = acceleration

    def predict(self, estimate: Estimate) -> tuple[Array, Array]:
        """Predict position and velocity (3,), m and m/s, one lag ahead.

        The modelled acceleration from the last call of `advance` is held constant over the lag.
        """
        ahead = np.empty((2, 3))
        state = np.array([estimate.position, estimate.velocity])
        predict_response(state, self._response, self.lag, ahead)
        return ahead[0], ahead[1]


class PathGuidance:
    """Guidance along polynomial paths of one shape, with compensation of the lag.

    The vehicle responds to a command with a lag. The boundary value problem is therefore solved
    from the state predicted one `lag` ahead with a first-order model of the past commands. Near the
    target the gains would grow without bound; below `min_time_to_go` the last path is flown open
    loop.

    Parameters
    ----------
    shape
        Shape of the paths.
    gravity
        Downward acceleration, m/s^2.
    lag
        Response lag of attitude control and engine that is compensated, s.
    min_time_to_go
        Time-to-go below which the last path is flown open loop, s.
    feedback
        Feedback formula of the law; None: initial acceleration of the path.
    lag_model
        Response model shared with another law; it replaces `lag`.
    gravity_model
        Gravity model (non-uniform gravity and rotating frame) to compensate; None: uniform
        `gravity`.

    Raises
    ------
    InputError
        From `command`, if the estimate or the end is not finite.
    """

    def __init__(
        self,
        shape: PathShape,
        gravity: float,
        *,
        lag: float = 0.0,
        min_time_to_go: float = 1.5,
        feedback: FeedbackLaw | None = None,
        lag_model: ActuatorLagModel | None = None,
        gravity_model: GravityModel | None = None,
    ) -> None:
        self.shape = shape
        self._gravity_model = gravity_model
        self.gravity = np.array([0.0, 0.0, -gravity])
        self.min_time_to_go = min_time_to_go
        self.feedback = feedback
        self._lag_model = lag_model or ActuatorLagModel(lag)
        self._lag = self._lag_model.lag
        self._last: tuple[float, PolynomialPath] | None = None

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2, towards the phase end.

        If no path exists yet, a time-to-go below the minimum is raised to it. `time` and
        `time_to_go` are in s.
        """
        self._lag_model.advance(time)
        path_time = time_to_go - self._lag
        check_finite("guidance.time_to_go", time_to_go)
        if path_time >= self.min_time_to_go or self._last is None:
            position, velocity = self._lag_model.predict(estimate)
            path_time = max(path_time, self.min_time_to_go)
            path = self.shape.path(position, velocity, end, path_time)
            self._last = (time, path)
            acceleration = (
                path.command
                if self.feedback is None
                else np.asarray(self.feedback(position, velocity, end, path_time))
            )
        else:
            since, path = self._last
            acceleration = path.at(min(time - since, path.time_to_go))[2]
        self._lag_model.record_command(acceleration)
        free_fall = self.gravity
        if self._gravity_model is not None:
            free_fall = self._gravity_model.free_fall_acceleration(
                estimate.position, estimate.velocity
            )
        return np.asarray(acceleration - free_fall)
