"""Augmented Apollo guidance (Lu, "Augmented Apollo powered descent guidance", JGCD 42(3), 2019).

One gain moves the path between E-guidance (6) and the Apollo law (12) and beyond.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.onboard.guidance.fractional import FractionalPolynomialLaw
from lunarsim.parts.quantity import quantity


@dataclass(frozen=True)
class AugmentedApolloLaw(FractionalPolynomialLaw):
    """Augmented Apollo guidance (Lu 2019): the fractional polynomial with gamma = 1.

    Attributes
    ----------
    gamma
        1.
    gain
        k_r: 6 is E-guidance, 12 the Apollo law.
    """

    gamma: float = quantity(1.0, ge=1, le=1, help="1 is what makes it the augmented Apollo law")
    gain: float = quantity(8.0, ge=6, le=200, help="k_r: 6 is E-guidance, 12 the Apollo law")
