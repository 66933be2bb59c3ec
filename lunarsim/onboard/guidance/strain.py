"""A path that asks for more than the lander can do: noticed, so that it can be planned afresh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass
class Strain:
    """How long commands have leaned or pushed beyond the limits.

    A path is chosen within the limits from where navigation then took the lander to be. What it
    learns afterwards may leave the path beyond them: a lander that cannot follow passes its end
    with the speed that it could not take out.

    Attributes
    ----------
    longest
        So long is nothing out of the ordinary, s.
    slack
        Share by which a limit may be passed.
    """

    longest: float = 0.5
    slack: float = 0.02
    _since: float | None = None

    def lasts(
        self, wanted: NDArray[np.float64], mass: float, most: tuple[float, float], time: float
    ) -> bool:
        """Tell whether commands have been beyond the limits for too long, and begin anew if so.

        Parameters
        ----------
        wanted
            Thrust acceleration (3,), ENU, m/s^2.
        mass
            kg.
        most
            Greatest lean from the vertical, rad, and thrust, N.
        time
            s, once a cycle.
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
