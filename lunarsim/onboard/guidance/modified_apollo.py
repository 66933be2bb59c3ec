"""The modified Apollo law: the time-to-go respects limits on jerk and snap.

The paths are Klumpp's. The quadtree paper ranks sites by their increments at the least such time
(its Eq. 10). A lander that flies them has limits of thrust and tilt besides, which may ask for more
time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert import DivertCost, PathLimits, divert_cost
from lunarsim.onboard.guidance.jerk_limited import limited_times
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModifiedApolloLaw(ApolloLaw):
    """The Apollo law with its time-to-go by limits on jerk and snap.

    Attributes
    ----------
    jerk, snap
        Limits, m/s^3 and m/s^4.
    """

    jerk: float = quantity(0.25, "m/s^3", gt=0, help="greatest along the path")
    snap: float = quantity(0.05, "m/s^4", gt=0, help="greatest along the path")

    def cost(
        self,
        estimate: Estimate,
        end: PhaseEnd,
        lander: Lander,
        gravity: float,
        limits: PathLimits | None = None,
        times: Array | None = None,
    ) -> DivertCost:
        """Return what it takes to reach each end without breaking either limit.

        The time-to-go is the cheapest that is admissible from the least one on that keeps both.
        """
        least = limited_times(
            estimate.position, estimate.velocity, end, jerk=self.jerk, snap=self.snap
        )
        return divert_cost(
            estimate, end, lander, gravity, limits=limits, shape=self.shape, least_times=least,
            times=times,
        )  # fmt: skip
