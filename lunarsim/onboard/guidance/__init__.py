"""How to fly to a site: laws, where phases end, what a divert costs."""

from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd

__all__ = ["GuidanceLaw", "PhaseEnd"]
