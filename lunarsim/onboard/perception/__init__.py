"""Perception: detection of rocks in camera images."""

from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import Detections, detect_rocks
from lunarsim.onboard.perception.shadow_model import ShadowModel

__all__ = ["DetectionRates", "Detections", "ShadowModel", "detect_rocks"]
