"""Measurement models for attitudes, slant ranges and Doppler speeds."""

from lunarsim.onboard.navigation.measured.attitude import is_symmetric, update_with_attitude
from lunarsim.onboard.navigation.measured.ranges import MAX_SIGMA_M, MIN_DOWN_COSINE, take_range
from lunarsim.onboard.navigation.measured.speeds import speed_bias_model, update_with_speeds

__all__ = [
    "MAX_SIGMA_M",
    "MIN_DOWN_COSINE",
    "is_symmetric",
    "speed_bias_model",
    "take_range",
    "update_with_attitude",
    "update_with_speeds",
]
