"""Paths to a final state with two power terms in the acceleration.

With tau the time-to-go, the acceleration (gravity included) is
``a = a_f + k1 tau^p + k2 tau^q`` with ``0 <= p < q``: the family of Lu, "Theory of
fractional-polynomial powered descent guidance", Journal of Guidance, Control, and Dynamics 43(3),
2020. Powers 1 and 2 give the Apollo law (Klumpp 1974), 0 and 1 E-guidance (Cherry 1964).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.core.path_cost import power_terms
from lunarsim.errors import InputError
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite


@dataclass(frozen=True)
class PolynomialPath:
    """Path from the current state to a phase end, with two powers of time-to-go.

    Attributes
    ----------
    end
        Required position, velocity and acceleration at the end.
    time_to_go
        Duration, s.
    powers
        Powers of time-to-go in the acceleration.
    terms
        Contribution of each power to the initial acceleration (2, 3), m/s^2.
    """

    end: PhaseEnd
    time_to_go: float
    powers: tuple[float, float]
    terms: Array

    @property
    def command(self) -> Array:
        """Initial acceleration (3,), m/s^2, gravity included."""
        return np.asarray(self.end.acceleration + (self.terms[0] + self.terms[1]))

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (..., 3) at times on the path.

        `t` (...), s, is measured from the start of the path.
        """
        left = (self.time_to_go - np.asarray(t, dtype=np.float64))[..., None]
        share = left / self.time_to_go
        a = np.zeros(share.shape) + self.end.acceleration
        v = self.end.velocity - left * a
        r = self.end.position - left * self.end.velocity + 0.5 * left**2 * a
        for power, term in zip(self.powers, self.terms, strict=True):
            pull = term * share**power
            a = a + pull
            v = v - left * pull / (power + 1.0)
            r = r + left**2 * pull / ((power + 1.0) * (power + 2.0))
        return r, v, a


@dataclass(frozen=True)
class PathShape:
    """Two powers of time-to-go in the acceleration, which define a family of paths.

    Attributes
    ----------
    low, high
        Powers, with ``0 <= low < high``.

    Raises
    ------
    InputError
        If the powers are not finite, or not in this order.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (0.0 <= self.low < self.high < np.inf):
            raise InputError(
                "guidance.powers",
                (self.low, self.high),
                "must be two finite numbers of 0 or more in ascending order",
            )

    @property
    def powers(self) -> tuple[float, float]:
        """Both powers of time-to-go, the lower one first."""
        return self.low, self.high

    def path(
        self, position: ArrayLike, velocity: ArrayLike, end: PhaseEnd, time_to_go: float
    ) -> PolynomialPath:
        """Return the unique path of this shape from a state to a phase end.

        Parameters
        ----------
        position, velocity
            Current state (3,), m and m/s.
        end
            Required state at the phase end.
        time_to_go
            Duration of the path, s.

        Raises
        ------
        InputError
            If the time-to-go is not positive, or a value is not finite.
        """
        if not 0.0 < time_to_go < np.inf:
            raise InputError("guidance.time_to_go", time_to_go, "must be positive and finite")
        terms = np.empty((2, 3))
        power_terms(
            np.array([position, velocity], dtype=np.float64),
            np.array(end.position, dtype=np.float64),
            np.array([end.velocity, end.acceleration], dtype=np.float64), float(time_to_go),
            np.array(self.powers), terms,
        )  # fmt: skip
        # An input that is not finite makes terms that are not.
        if not np.isfinite(terms).all():
            for name, value in (
                ("position", position), ("velocity", velocity), ("end.position", end.position),
                ("end.velocity", end.velocity), ("end.acceleration", end.acceleration),
            ):  # fmt: skip
                check_finite(f"guidance.{name}", value)
        terms[0] *= self.low + 1.0
        terms[1] *= self.high + 1.0
        return PolynomialPath(end, float(time_to_go), self.powers, terms)


APOLLO = PathShape(1.0, 2.0)
E_GUIDANCE = PathShape(0.0, 1.0)
