"""Measurement models for attitudes, slant ranges and Doppler speeds."""

from lunarsim.onboard.navigation.measured.attitude import symmetric, take_attitude
from lunarsim.onboard.navigation.measured.ranges import LEAST_DOWN, VAGUE, take_range
from lunarsim.onboard.navigation.measured.speeds import speed_errors, take_speeds

__all__ = [
    "LEAST_DOWN",
    "VAGUE",
    "speed_errors",
    "symmetric",
    "take_attitude",
    "take_range",
    "take_speeds",
]
