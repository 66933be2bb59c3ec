"""E-guidance: acceleration linear in time.

Cherry, "A general, explicit, optimizing guidance law for rocket-propelled spaceflight", AIAA paper
64-638, 1964. It meets position and velocity at the target. Under uniform gravity and a fixed
time-to-go it minimises the integral of the squared thrust acceleration. The acceleration at the
target is free.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import E_GUIDANCE, PathShape


@dataclass(frozen=True)
class EGuidanceLaw(PathLaw):
    """Settings of the E-guidance law (Cherry 1964): acceleration linear in time."""

    @property
    def shape(self) -> PathShape:
        """Shape of the paths: acceleration with constant and linear terms of time-to-go."""
        return E_GUIDANCE
