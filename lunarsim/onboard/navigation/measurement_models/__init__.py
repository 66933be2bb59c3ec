"""Measurement models for attitudes, slant ranges and Doppler speeds."""

from lunarsim.onboard.navigation.measurement_models.attitude import (
    is_symmetric,
    update_with_attitude,
)
from lunarsim.onboard.navigation.measurement_models.ranges import (
    MAX_SIGMA_M,
    MIN_DOWN_COSINE,
    update_with_range,
)
from lunarsim.onboard.navigation.measurement_models.speeds import (
    speed_bias_model,
    update_with_speeds,
)

__all__ = [
    "MAX_SIGMA_M",
    "MIN_DOWN_COSINE",
    "is_symmetric",
    "speed_bias_model",
    "update_with_attitude",
    "update_with_range",
    "update_with_speeds",
]
