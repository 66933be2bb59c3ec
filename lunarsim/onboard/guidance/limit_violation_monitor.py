"""Detection of paths that exceed the lander's limits and need replanning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.core.guidance import exceeds_limits
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

    max_duration: float = 0.5
    slack: float = 0.02
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
