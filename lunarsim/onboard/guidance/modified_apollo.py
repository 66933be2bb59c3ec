"""Modified Apollo law: time-to-go respects limits on jerk and snap.

The paths are Klumpp's. The quadtree paper ranks sites by their delta-v at the minimum time-to-go
within these limits (its Eq. 10). Limits on thrust and tilt may require a longer time.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import DivertCost, PathLimits, divert_cost
from lunarsim.onboard.guidance.jerk_limited import min_times_to_go
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


@dataclass(frozen=True)
class ModifiedApolloLaw(ApolloLaw):
    """Settings of the Apollo law with limits on jerk and snap of its paths.

    Attributes
    ----------
    jerk, snap
        Maximum jerk, m/s^3, and snap, m/s^4, which define a minimum time-to-go.
    """

    jerk: float = quantity(0.25, "m/s^3", gt=0, help="maximum jerk along the path")
    snap: float = quantity(
        0.05, "m/s^4", gt=0, help="maximum snap (time derivative of jerk) along the path"
    )

    def cost(
        self,
        estimate: Estimate,
        end: PhaseEnd,
        lander: Lander,
        gravity: float,
        limits: PathLimits | None = None,
        times: Array | None = None,
    ) -> DivertCost:
        """Return the propellant cost of reaching each end within the limits.

        Time-to-go is the optimal admissible one above the minimum from the limits of jerk and snap;
        `times` (n,), s, replaces it. `limits` are those of thrust, tilt, glideslope and propellant.
        """
        min_times = min_times_to_go(
            estimate.position, estimate.velocity, end, jerk=self.jerk, snap=self.snap
        )
        return divert_cost(
            estimate, end, lander, gravity, limits=limits, shape=self.shape, min_times=min_times,
            times=times,
        )  # fmt: skip
