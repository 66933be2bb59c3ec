"""Zero-effort-miss/zero-effort-velocity (ZEM/ZEV) feedback guidance.

Ebrahimi, Bahrami and Roshanian, "Optimal sliding-mode guidance with terminal velocity constraint
for fixed-interval propulsive maneuvers", Acta Astronautica 62, 2008; Guo, Hawkins and Wie,
"Applications of generalized zero-effort-miss/zero-effort-velocity feedback guidance algorithm",
Journal of Guidance, Control, and Dynamics 36(3), 2013.

The predicted miss and velocity error without thrust are fed back with the gains of minimum control
effort. Under uniform gravity this is E-guidance in feedback form.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.core.feedback import zem_zev
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import E_GUIDANCE, PathShape


@dataclass(frozen=True)
class ZemZevLaw(PathLaw):
    """Settings of zero-effort-miss/zero-effort-velocity feedback (Guo 2013).

    The law is also in Ebrahimi 2008.
    """

    formula = staticmethod(zem_zev)

    @property
    def shape(self) -> PathShape:
        """Shape of E-guidance, whose paths are the same for a vehicle without lag."""
        return E_GUIDANCE
