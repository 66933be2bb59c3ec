"""E-guidance: the acceleration is linear in time.

Cherry, "A general, explicit, optimizing guidance law for rocket-propelled spaceflight", AIAA paper
64-638, 1964. That meets position and velocity at the target and, under constant gravity and a fixed
time-to-go, has the least integral of the squared thrust acceleration. The acceleration at the
target is what comes out.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import E_GUIDANCE, PathShape


@dataclass(frozen=True)
class EGuidanceLaw(PathLaw):
    """E-guidance (Cherry 1964): acceleration linear in time."""

    @property
    def shape(self) -> PathShape:
        """Constant and linear in the time that is left."""
        return E_GUIDANCE
