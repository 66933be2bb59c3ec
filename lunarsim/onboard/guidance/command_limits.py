"""Limits of commands and of position corrections that guidance follows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lunarsim.core.guidance import MAX_VIOLATION_S, VIOLATION_SLACK, exceeds_limits
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array


@dataclass
class LimitViolationMonitor:
    """Measure how long commands have exceeded the limits of tilt or thrust.

    A path is planned within the limits from the position estimate at that time. Later corrections
    of the estimate may drive commands beyond the limits. A lander that cannot follow its path
    arrives with excess speed.

    Attributes
    ----------
    max_duration
        Tolerated duration of a violation, s.
    slack
        Tolerated relative violation of a limit.
    """

    max_duration: float = MAX_VIOLATION_S
    slack: float = VIOLATION_SLACK
    _start_time: float | None = None

    def exceeds_duration(
        self, command: Array, mass: float, limits: tuple[float, float], time: float
    ) -> bool:
        """Return whether a limit violation has lasted too long; restart the timer if so.

        Parameters
        ----------
        command
            Commanded thrust acceleration (3,), ENU, m/s^2.
        mass
            Current mass, kg.
        limits
            Maximum tilt from the vertical, rad, and maximum thrust, N.
        time
            Current time, s; the method is called once per control cycle.
        """
        if not exceeds_limits(np.array(command, np.float64), mass, *limits, self.slack):
            self._start_time = None
            return False
        if self._start_time is None:
            self._start_time = time
        if time - self._start_time < self.max_duration - 1e-9:
            return False
        self._start_time = None
        return True


@dataclass
class PositionCorrectionLimiter:
    """Limit the rate of horizontal position corrections near the end of a path.

    A navigation filter corrects its position in steps, sometimes by a metre. A path with a
    time-to-go T responds to a step d with an acceleration of 6 d / T^2: 1.5 m/s^2 for 1 m and 2 s.
    This exceeds the tilt limit, and the correction is incomplete at the end of the path. The
    position for guidance is therefore propagated with the velocity, and corrections are applied at
    a limited rate that grows with time-to-go. The vertical descent applies the rest.

    Attributes
    ----------
    active_time_to_go
        Time-to-go below which the limit applies, s; before, the estimate is used unchanged.
    min_rate
        Minimum correction rate, m/s.
    rate_growth
        Increase of the correction rate per second of time-to-go, m/s^2.
    """

    active_time_to_go: float = 12.0
    min_rate: float = 0.15
    rate_growth: float = 0.06
    _time: float = -np.inf
    _position: Array | None = None

    def limit(self, estimate: Estimate, time_left: float) -> Estimate:
        """Return the navigation estimate with a rate-limited position, for guidance.

        Only the horizontal position can differ from that of `estimate`.

        Parameters
        ----------
        estimate
            Navigation estimate; the method is called once per control cycle.
        time_left
            Time until the path ends, s; inf: no limit.
        """
        position, elapsed = estimate.position[:2], estimate.time - self._time
        if self._position is not None and time_left < self.active_time_to_go:
            propagated = self._position + elapsed * estimate.velocity[:2]
            correction = position - propagated
            size = float(np.hypot(correction[0], correction[1]))
            limit = max(self.min_rate, self.rate_growth * time_left) * elapsed
            if size > limit:
                position = propagated + correction * (limit / size)
        self._time, self._position = estimate.time, position.copy()
        return replace(estimate, position=np.append(position, estimate.position[2]))
