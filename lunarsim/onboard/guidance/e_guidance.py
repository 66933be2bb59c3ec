"""E-guidance: the acceleration is linear in time.

Cherry, "A general, explicit, optimizing guidance law for rocket-propelled spaceflight", AIAA paper
64-638, 1964. That meets position and velocity at the target and, under constant gravity and a fixed
time-to-go, has the least integral of the squared thrust acceleration. The acceleration at the
target is what comes out.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.divert import PathLaw
from lunarsim.onboard.guidance.following import PathGuidance
from lunarsim.onboard.guidance.paths import E_GUIDANCE, PathShape
from lunarsim.parts.quantity import quantity


@dataclass(frozen=True)
class EGuidanceLaw(PathLaw):
    """E-guidance (Cherry 1964): acceleration linear in time.

    Attributes
    ----------
    least_time_to_go
        Below this time-to-go the loop is open, s.
    """

    least_time_to_go: float = quantity(
        1.5, "s", gt=0, help="below it the last path is flown out open loop"
    )

    @property
    def shape(self) -> PathShape:
        """Constant and linear in the time that is left."""
        return E_GUIDANCE

    def build(self, briefing: Briefing, lag: float) -> PathGuidance:
        """Return the law of one flight."""
        return PathGuidance(
            E_GUIDANCE, briefing.weight, lead=lag, least_time_to_go=self.least_time_to_go
        )
