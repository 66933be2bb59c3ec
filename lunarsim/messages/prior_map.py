"""The map that a lander brings along: coarser than the ground, noisy, out of date in places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PriorMap:
    """Elevations of posts, each the mean over its square.

    Attributes
    ----------
    grid
        Places the posts in the frame of the planet.
    elevation
        m (rows, cols); NaN where the map has none.
    sigma
        Standard deviation of a post's error, m.
    correlation
        Distance at which the errors of two posts are still alike by exp(-1/2), m; 0: each post errs
        on its own.
    """

    grid: Grid
    elevation: Array
    sigma: float
    correlation: float = 0.0

    def __post_init__(self) -> None:
        if self.elevation.shape != self.grid.shape:
            raise InputError(
                "prior.elevation", self.elevation.shape, f"an array of {self.grid.shape}"
            )
        if np.isinf(self.elevation).any() or not np.isfinite(self.elevation).any():
            raise InputError(
                "prior.elevation", "no finite elevation", "elevations in m, NaN for none"
            )
        if not (np.isfinite(self.sigma) and self.sigma > 0.0):
            raise InputError("prior.sigma_m", self.sigma, "a positive deviation in metres")
        if not (np.isfinite(self.correlation) and self.correlation >= 0.0):
            raise InputError("prior.correlation_m", self.correlation, "a length in metres, or 0")

    @property
    def together(self) -> float:
        """Number of posts that err as one: the sum of the correlations of a post with all others.

        They fall as a Gaussian of the distance over `correlation`.
        """
        reach = self.correlation / self.grid.posting
        if reach == 0.0:
            return 1.0
        n = np.arange(1.0, np.ceil(5.0 * reach) + 1.0)
        return float((1.0 + 2.0 * np.exp(-0.5 * (n / reach) ** 2).sum()) ** 2)
