"""Paths that meet position and velocity at their end with an acceleration of two powers.

With tau the time that is left, the acceleration (gravity included) is
``a = a_f + k1 tau^p + k2 tau^q`` with ``0 <= p < q``: the family of Lu, "Theory of
fractional-polynomial powered descent guidance", Journal of Guidance, Control, and Dynamics 43(3),
2020. Powers 1 and 2 are the Apollo law (Klumpp 1974), 0 and 1 E-guidance (Cherry 1964).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.guidance.contract import PhaseEnd

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Path:
    """A path from now to its end.

    Attributes
    ----------
    end
        Position, velocity and acceleration wanted there.
    time_to_go
        Duration, s.
    powers
        Of the time that is left.
    terms
        What each power gives to the acceleration at the start (2, 3), m/s^2.
    """

    end: PhaseEnd
    time_to_go: float
    powers: tuple[float, float]
    terms: Array

    @property
    def command(self) -> Array:
        """Acceleration at the start (3,), m/s^2."""
        return np.asarray(self.end.acceleration + self.terms.sum(axis=0))

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (..., 3) at times `t` (...), s."""
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
    """The two powers of a family of paths.

    Attributes
    ----------
    low, high
        ``0 <= low < high``.

    Raises
    ------
    InputError
        If they are not so.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (0.0 <= self.low < self.high < np.inf):
            raise InputError("guidance.powers", (self.low, self.high), "0 <= low < high")

    @property
    def powers(self) -> tuple[float, float]:
        """Both."""
        return self.low, self.high

    def path(
        self, position: ArrayLike, velocity: ArrayLike, end: PhaseEnd, time_to_go: float
    ) -> Path:
        """Return the one path of this shape from here to an end.

        Parameters
        ----------
        position, velocity
            Now (3,), m and m/s.
        end
            Where it ends.
        time_to_go
            s.

        Raises
        ------
        InputError
            If the time-to-go is not positive, or something is not finite.
        """
        if not 0.0 < time_to_go < np.inf:
            raise InputError("guidance.time_to_go", time_to_go, "a positive time in s")
        r, v = np.asarray(position, dtype=np.float64), np.asarray(velocity, dtype=np.float64)
        wanted = (end.position, end.velocity, end.acceleration)
        if not all(np.isfinite(x).all() for x in (r, v, *wanted)):
            raise InputError("guidance.estimate", (r.tolist(), v.tolist()), "finite coordinates")
        low, high = self.powers
        # What both powers add to the mean acceleration, and to the way it makes (over time^2).
        p = (end.velocity - v) / time_to_go - end.acceleration
        q = (end.velocity * time_to_go - (end.position - r)) / time_to_go**2
        q = q - 0.5 * end.acceleration
        first = (low + 2.0) * ((high + 2.0) * q - p) / (high - low)
        terms = np.stack(((low + 1.0) * first, (high + 1.0) * (p - first)))
        return Path(end, float(time_to_go), self.powers, terms)


APOLLO = PathShape(1.0, 2.0)
E_GUIDANCE = PathShape(0.0, 1.0)
