"""Shadow-based hazard detection: rocks seen by their shadows, tracked in an EKF, mapped.

The system of the shadow EKF paper: `detect_rocks` finds rocks in an image, `RockFilter` tracks
them together with the lander, `RockTracker` decides which are the same and which are gone,
`ProbabilityMap` turns them into a map, and `ShadowMapper` joins the four for the closed loop.
"""

from lunarsim.onboard.hazards.shadows.mapper import ShadowMapper
from lunarsim.onboard.hazards.shadows.probability import cover_probability
from lunarsim.onboard.hazards.shadows.probability_map import HazardPrior, ProbabilityMap
from lunarsim.onboard.hazards.shadows.tracker import RockTracker
from lunarsim.onboard.hazards.shadows.tracker_settings import TrackerSettings

__all__ = [
    "HazardPrior",
    "ProbabilityMap",
    "RockTracker",
    "ShadowMapper",
    "TrackerSettings",
    "cover_probability",
]
