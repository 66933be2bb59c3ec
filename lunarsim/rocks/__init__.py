"""Rocks: size distributions, unit shapes and arrays of rocks.

The package is independent of the true world and of the onboard computer, which both use it.
"""

from lunarsim.rocks.field import RockField, RockModel
from lunarsim.rocks.size_distribution import (
    golombek_cover,
    golombek_exponent,
    golombek_number,
    sample_diameters,
)

__all__ = [
    "RockField",
    "RockModel",
    "golombek_cover",
    "golombek_exponent",
    "golombek_number",
    "sample_diameters",
]
