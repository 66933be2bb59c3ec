"""Detection of paths that exceed the lander's limits and need replanning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass
class Strain:
    """Measure how long commands have exceeded the limits of tilt or thrust.

    A path is planned within the limits from the position estimate at that time. Later corrections
    of the estimate may drive commands beyond the limits. A lander that cannot follow its path
    arrives with excess speed.

    Attributes
    ----------
    longest
        Tolerated duration of a violation, s.
    slack
        Tolerated relative violation of a limit.
    """

    longest: float = 0.5
    slack: float = 0.02
    _since: float | None = None

    def lasts(
        self, wanted: NDArray[np.float64], mass: float, most: tuple[float, float], time: float
    ) -> bool:
        """Return whether a violation lasts too long; restart the timer if so.

        Parameters
        ----------
        wanted
            Commanded thrust acceleration (3,), ENU, m/s^2.
        mass
            kg.
        most
            Maximum tilt from the vertical, rad, and maximum thrust, N.
        time
            s, once per cycle.
        """
        lean = float(np.arctan2(np.hypot(wanted[0], wanted[1]), wanted[2]))
        push = mass * float(np.linalg.norm(wanted))
        if lean <= (1.0 + self.slack) * most[0] and push <= (1.0 + self.slack) * most[1]:
            self._since = None
            return False
        if self._since is None:
            self._since = time
        if time - self._since < self.longest - 1e-9:
            return False
        self._since = None
        return True
