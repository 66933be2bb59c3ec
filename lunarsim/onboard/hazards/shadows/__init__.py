"""Shadow-based hazard detection: rocks are detected by their shadows and tracked.

This is the system of the shadow EKF paper. `detect_rocks` detects rocks in an image, `RockFilter`
estimates them together with the lander's state, `RockTracker` associates detections and adds or
removes rocks, `ProbabilityMap` computes the map, and `ShadowMapper` combines the four.
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
