"""Shadow-based hazard detection: rocks seen by their shadows, tracked in an EKF, mapped.

The system of the shadow EKF paper: `detect_rocks` finds rocks in an image, `RockFilter` tracks
them together with the lander, `RockTracker` decides which are the same and which are gone,
`ProbabilityMap` turns them into a map, and `ShadowMapper` joins the four for the closed loop.
"""

from lunarsim.hazards.shadows.detection_rates import DetectionRates
from lunarsim.hazards.shadows.detector import Detections, DetectorSettings, detect_rocks
from lunarsim.hazards.shadows.mapper import ShadowMapper, Shot
from lunarsim.hazards.shadows.probability import cover_probability
from lunarsim.hazards.shadows.probability_map import HazardPrior, ProbabilityMap
from lunarsim.hazards.shadows.rock_filter import RockFilter
from lunarsim.hazards.shadows.shadow_model import ShadowModel
from lunarsim.hazards.shadows.tracker import RockTracker, TrackerSettings

__all__ = [
    "DetectionRates",
    "Detections",
    "DetectorSettings",
    "HazardPrior",
    "ProbabilityMap",
    "RockFilter",
    "RockTracker",
    "ShadowMapper",
    "ShadowModel",
    "Shot",
    "TrackerSettings",
    "cover_probability",
    "detect_rocks",
]
