"""Augmented Apollo guidance.

Lu, "Augmented Apollo powered descent guidance", JGCD 42(3), 2019. One gain varies the path from
E-guidance (6) over the Apollo law (12) to larger values.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.onboard.guidance.fractional import FractionalPolynomialLaw
from lunarsim.parts.quantity import quantity


@dataclass(frozen=True)
class AugmentedApolloLaw(FractionalPolynomialLaw):
    """Settings of augmented Apollo guidance (Lu 2019).

    This is the fractional-polynomial law with gamma = 1.

    Attributes
    ----------
    gamma
        Fixed at 1.
    gain
        Gain k_r of the position error: 6 gives E-guidance, 12 the Apollo law.
    """

    gamma: float = quantity(
        1.0,
        ge=1,
        le=1,
        help="exponent of time-to-go in the acceleration; 1 is the only value of this law",
    )
    gain: float = quantity(
        8.0,
        ge=6,
        le=200,
        help="feedback gain k_r of the position error; 6 gives E-guidance, 12 gives the Apollo law",
    )
