"""Navigation: where the lander believes it is, and how sure it is."""

from lunarsim.navigation.error_model import NavigationErrorModel
from lunarsim.navigation.estimate import Estimate, Navigation

__all__ = ["Estimate", "Navigation", "NavigationErrorModel"]
