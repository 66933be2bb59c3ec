"""Corrections of the place near the end of a path: taken up slowly, not chased."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.navigation.estimate import Estimate


@dataclass
class SteadyPlace:
    """Where guidance takes the lander to be, east and north, while little time is left.

    A filter moves its position in steps, by a metre at times. A path with T s left answers a step
    d with 6 d / T^2 at once: 1.5 m/s^2 for a metre and two seconds, which is more than a lander
    can lean for and is still being flown when the path ends. So the place is carried on with the
    velocity, and what navigation has moved it by besides is taken up by no more than `creep`, and
    by more while there is time to fly it out. What is not taken up by touchdown is missed by.

    Attributes
    ----------
    within
        Of the end of the path, s; before, the estimate is taken as it is.
    creep
        Least speed of taking it up, m/s.
    growth
        By so much more can be taken up for each second left, m/s^2.
    """

    within: float = 12.0
    creep: float = 0.15
    growth: float = 0.06
    _time: float = -np.inf
    _place: NDArray[np.float64] | None = None

    def of(self, estimate: Estimate, time_left: float) -> Estimate:
        """Return the estimate for guidance.

        Parameters
        ----------
        estimate
            Of navigation, once a cycle.
        time_left
            Until the path ends, s; 0 after it.
        """
        place, passed = estimate.position[:2], estimate.time - self._time
        if self._place is not None and time_left < self.within:
            carried = self._place + passed * estimate.velocity[:2]
            off = place - carried
            size = float(np.hypot(off[0], off[1]))
            most = max(self.creep, self.growth * time_left) * passed
            if size > most:
                place = carried + off * (most / size)
        self._time, self._place = estimate.time, place.copy()
        return replace(estimate, position=np.append(place, estimate.position[2]))
