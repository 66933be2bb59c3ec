"""Rocks as such, wherever they lie: size laws, unit shapes, arrays of rocks.

Neutral ground: the true world places them, the onboard computer expects them.
"""

from lunarsim.rocks.field import RockField, RockModel
from lunarsim.rocks.laws import (
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
