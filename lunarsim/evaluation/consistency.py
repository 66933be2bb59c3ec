"""Check filter consistency by normalised errors and innovations, and their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2


def normalised_squared_error(error: ArrayLike, covariance: ArrayLike) -> float:
    """Return ``e' P^-1 e`` of an error e (d,) and its predicted covariance P (d, d).

    The result is chi-squared with d degrees of freedom for a consistent filter: the NEES of an
    estimate, the NIS of an innovation (Bar-Shalom, Li and Kirubarajan 2001, section 5.4).
    """
    e = np.asarray(error, dtype=np.float64)
    return float(e @ np.linalg.solve(np.asarray(covariance, dtype=np.float64), e))


@dataclass(frozen=True)
class Consistency:
    """Sum of normalised squared errors over trials, to test filter consistency.

    Attributes
    ----------
    total, degrees
        Sum of the normalised squared errors, and its degrees of freedom.
    """

    total: float = 0.0
    degrees: int = 0

    def plus(self, square: float, degrees: int) -> Consistency:
        """Return the sum with one more normalised squared error `square` added.

        `degrees` are the degrees of freedom of this error.
        """
        return Consistency(self.total + square, self.degrees + degrees)

    @property
    def ratio(self) -> float:
        """Sum over its expected value: about 1 if consistent; NaN without trials."""
        return self.total / self.degrees if self.degrees else float("nan")

    def bounds(self, level: float = 0.95) -> tuple[float, float]:
        """Return the interval that contains `ratio` if the filter is consistent.

        `level` is the probability of the interval.
        """
        tail = 0.5 * (1.0 - level)
        low, high = chi2.ppf([tail, 1.0 - tail], self.degrees) / self.degrees
        return float(low), float(high)

    def holds(self, level: float = 0.95) -> bool:
        """Return whether `ratio` is inside the interval of probability `level`."""
        low, high = self.bounds(level)
        return low <= self.ratio <= high
