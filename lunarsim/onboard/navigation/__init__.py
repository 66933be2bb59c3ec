"""Navigation: where the lander believes it is, and how sure it is."""

from lunarsim.onboard.navigation.estimate import Estimate, Navigation

__all__ = ["Estimate", "Navigation"]
