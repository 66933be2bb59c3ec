"""Guidance along paths of one shape, with lag compensation and an open-loop end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.models.gravity import GravityModel
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.paths import PathShape, PolynomialPath
from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]

# Maps position, velocity, end and time-to-go to the required acceleration, gravity included.
FeedbackLaw = Callable[[Array, Array, PhaseEnd, float], Array]


class ActuatorLagModel:
    """First-order model of the vehicle's response to acceleration commands.

    Parameters
    ----------
    lead
        Time constant of the response, s.
    """

    def __init__(self, lead: float) -> None:
        self.lag = lead
        self._lagged = np.zeros(3)
        self._command = np.zeros(3)
        self._time: float | None = None

    def advance(self, time: float) -> None:
        """Propagate the modelled acceleration of the vehicle to `time`, s."""
        if self.lag > 0.0 and self._time is not None:
            keep = np.exp(-(time - self._time) / self.lag)
            self._lagged = self._command + keep * (self._lagged - self._command)
        self._time = time

    def record_command(self, acceleration: Array) -> None:
        """Store the commanded acceleration (3,), gravity included, m/s^2."""
        self._command = acceleration

    def predict(self, estimate: Estimate) -> tuple[Array, Array]:
        """Predict position and velocity (3,), m and m/s, one lag ahead."""
        a, lead = self._lagged, self.lag
        position = estimate.position + lead * (estimate.velocity + 0.5 * lead * a)
        return position, estimate.velocity + lead * a


class PathGuidance:
    """Guidance along polynomial paths of one shape, with compensation of the lag.

    The vehicle responds to a command with a lag. The boundary value problem is therefore solved
    from the state predicted a `lead` ahead with a first-order model of the past commands. Near the
    target the gains would grow without bound; below `min_time_to_go` the last path is flown open
    loop.

    Parameters
    ----------
    shape
        Shape of the paths.
    gravity
        Downward acceleration, m/s^2.
    lead
        Response lag of attitude control and engine that is compensated, s.
    min_time_to_go
        Time-to-go below which the last path is flown open loop, s.
    feedback
        Feedback formula of the law; None: initial acceleration of the path.
    answering
        Response model shared with another law; it replaces `lead`.
    field
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
        lead: float = 0.0,
        min_time_to_go: float = 1.5,
        feedback: FeedbackLaw | None = None,
        answering: ActuatorLagModel | None = None,
        field: GravityModel | None = None,
    ) -> None:
        self.shape = shape
        self.field = field
        self.gravity = np.array([0.0, 0.0, -gravity])
        self.min_time_to_go = min_time_to_go
        self.feedback = feedback
        self._answering = answering or ActuatorLagModel(lead)
        self.lead = self._answering.lag
        self._last: tuple[float, PolynomialPath] | None = None

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2, towards the phase end.

        If no path exists yet, a time-to-go below the minimum is raised to it. `time` and
        `time_to_go` are in s.
        """
        self._answering.advance(time)
        left = time_to_go - self.lead
        if not np.isfinite(left):
            raise InputError("guidance.time_to_go", time_to_go, "must be finite")
        if left >= self.min_time_to_go or self._last is None:
            position, velocity = self._answering.predict(estimate)
            left = max(left, self.min_time_to_go)
            path = self.shape.path(position, velocity, end, left)
            self._last = (time, path)
            wanted = (
                path.command
                if self.feedback is None
                else np.asarray(self.feedback(position, velocity, end, left))
            )
        else:
            since, path = self._last
            wanted = path.at(min(time - since, path.time_to_go))[2]
        self._answering.record_command(wanted)
        pull = self.gravity
        if self.field is not None:
            pull = self.field.free_fall_acceleration(estimate.position, estimate.velocity)
        return np.asarray(wanted - pull)
