"""The Apollo polynomial law (Klumpp, "Apollo lunar descent guidance", Automatica 10, 1974).

The two-point boundary value problem of position and velocity now, and position, velocity and
acceleration at the target a time-to-go T later, has one solution with an acceleration quadratic
in time: ``a(t) = c0 + c1 t + c2 t^2``. It is solved afresh every cycle, which closes the loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PolynomialTrajectory:
    """A trajectory whose acceleration is quadratic in time.

    Attributes
    ----------
    position, velocity
        At t = 0 (3,), m and m/s.
    c
        Coefficients of the acceleration (3, 3), one row a power of time.
    time_to_go
        Duration, s.
    """

    position: Array
    velocity: Array
    c: Array
    time_to_go: float

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (..., 3) at times `t` (...)."""
        t = np.asarray(t, dtype=np.float64)[..., None]
        c0, c1, c2 = self.c
        r = self.position + t * (self.velocity + t * (c0 / 2 + t * (c1 / 6 + t * c2 / 12)))
        v = self.velocity + t * (c0 + t * (c1 / 2 + t * c2 / 3))
        return r, v, c0 + t * (c1 + t * c2)


def terminal_polynomial(
    position: ArrayLike, velocity: ArrayLike, end: PhaseEnd, time_to_go: float
) -> PolynomialTrajectory:
    """Solve the boundary value problem of the Apollo law.

    ``c0 = a_f + 12 (r_f - r) / T^2 - 6 (v_f + v) / T``; c1 and c2 follow from the velocity and
    acceleration at T.

    Raises
    ------
    ValueError
        If the time-to-go is not positive.
    """
    if not time_to_go > 0.0:
        raise ValueError(f"time_to_go = {time_to_go}: must be positive")
    r = np.asarray(position, dtype=np.float64)
    v = np.asarray(velocity, dtype=np.float64)
    big_t = time_to_go
    c0 = end.acceleration + 12.0 * (end.position - r) / big_t**2 - 6.0 * (end.velocity + v) / big_t
    da = end.acceleration - c0
    dv = end.velocity - v - c0 * big_t
    c1 = (6.0 * dv - 2.0 * da * big_t) / big_t**2
    c2 = (3.0 * da * big_t - 6.0 * dv) / big_t**3
    return PolynomialTrajectory(r, v, np.stack((c0, c1, c2)), big_t)


@dataclass(frozen=True)
class ApolloLaw:
    """The Apollo polynomial law (Klumpp 1974).

    Attributes
    ----------
    least_time_to_go
        Below this time-to-go the loop is open, s.
    """

    least_time_to_go: float = quantity(
        1.5, "s", gt=0, help="below it the last polynomial is flown out open loop"
    )

    def build(self, briefing: Briefing, lag: float) -> ApolloGuidance:
        """Return the law of one flight."""
        return ApolloGuidance(briefing.weight, lead=lag, least_time_to_go=self.least_time_to_go)


class ApolloGuidance:
    """The polynomial law in flight.

    The vehicle answers a command with a lag, so the boundary value problem is solved from
    where the lander will be a `lead` from now. The acceleration until then is that of the
    commands so far through a first-order lag. Near the target the gains would grow without
    bound; below `least_time_to_go` the last polynomial is flown out open loop.

    Parameters
    ----------
    gravity
        Downward acceleration, m/s^2.
    lead
        Lag of attitude and engine that is made up for, s.
    least_time_to_go
        Below this time-to-go the loop is open, s.
    """

    def __init__(self, gravity: float, *, lead: float = 0.0, least_time_to_go: float = 1.5) -> None:
        self.gravity = np.array([0.0, 0.0, -gravity])
        self.lead = lead
        self.least_time_to_go = least_time_to_go
        self._lagged = np.zeros(3)
        self._command = np.zeros(3)
        self._time: float | None = None
        self._last: tuple[float, PolynomialTrajectory] | None = None

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2."""
        self._follow(time)
        left = time_to_go - self.lead
        if left >= self.least_time_to_go or self._last is None:
            a, lead = self._lagged, self.lead
            position = estimate.position + lead * (estimate.velocity + 0.5 * lead * a)
            velocity = estimate.velocity + lead * a
            left = max(left, self.least_time_to_go)
            trajectory = terminal_polynomial(position, velocity, end, left)
            self._last = (time, trajectory)
            self._command = trajectory.c[0]
        else:
            since, trajectory = self._last
            elapsed = min(time - since, trajectory.time_to_go)
            self._command = trajectory.at(elapsed)[2]
        return np.asarray(self._command - self.gravity)

    def _follow(self, time: float) -> None:
        """Let the modelled acceleration follow the last command up to `time`."""
        if self.lead > 0.0 and self._time is not None:
            keep = np.exp(-(time - self._time) / self.lead)
            self._lagged = self._command + keep * (self._lagged - self._command)
        self._time = time
