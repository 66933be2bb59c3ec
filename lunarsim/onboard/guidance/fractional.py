"""Fractional-polynomial powered descent guidance.

Lu, "Theory of fractional-polynomial powered descent guidance", Journal of Guidance, Control, and
Dynamics 43(3), 2020. Two parameters shape the path, from E-guidance to laws that approach their
final acceleration early. `gamma` is one power of time-to-go; the gain ``k_r >= 2 (gamma + 2)``
gives the other power, ``k_r / (gamma + 2) - 2``. With gamma = 1, k_r = 12 gives the Apollo law and
k_r = 6 gives E-guidance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.core.feedback import fractional_polynomial
from lunarsim.errors import InputError
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import PathShape
from lunarsim.parts.quantity import quantity


def fractional_shape(gamma: float, gain: float) -> PathShape:
    """Return the path shape with powers `gamma` and ``gain / (gamma + 2) - 2``.

    The powers may come in either order. Equal powers need a logarithm and are rejected.

    Raises
    ------
    InputError
        If gamma is negative, or the gain is too small or makes the powers equal.
    """
    least = 2.0 * (gamma + 2.0)
    if not 0.0 <= gamma < np.inf:
        raise InputError("guidance.gamma", gamma, "must be 0 or more, and finite")
    if not least <= gain < np.inf:
        raise InputError(
            "guidance.gain", gain, f"must be finite and at least {least:g} if gamma is {gamma:g}"
        )
    other = gain / (gamma + 2.0) - 2.0
    if abs(other - gamma) < 1e-6:
        raise InputError(
            "guidance.gain", gain,
            f"must not be {(gamma + 2.0) ** 2:g} if gamma is {gamma:g}",
            "Otherwise the two powers of the path are equal.",
        )  # fmt: skip
    return PathShape(min(gamma, other), max(gamma, other))


@dataclass(frozen=True)
class FractionalPolynomialLaw(PathLaw):
    """Settings of fractional-polynomial powered descent guidance (Lu 2020).

    Attributes
    ----------
    gamma
        One of the two powers of time-to-go in the acceleration.
    gain
        Gain k_r of the position error, which gives the other power.
    """

    gamma: float = quantity(
        0.5, ge=0, le=10, help="one of the two exponents of time-to-go in the acceleration"
    )
    gain: float = quantity(
        8.0,
        gt=0,
        le=200,
        help="feedback gain k_r of the position error, at least 2 (gamma + 2); the second exponent "
        "of time-to-go in the acceleration is k_r / (gamma + 2) - 2",
    )

    formula = staticmethod(fractional_polynomial)

    def __post_init__(self) -> None:
        try:
            fractional_shape(self.gamma, self.gain)
        except InputError as error:
            raise error.with_field(error.field.rpartition(".")[2]) from None

    @property
    def shape(self) -> PathShape:
        """Shape of the paths that a vehicle without lag flies."""
        return fractional_shape(self.gamma, self.gain)

    @property
    def gains(self) -> tuple[float, ...]:
        """Parameters gamma and k_r of the feedback formula."""
        return self.gamma, self.gain
