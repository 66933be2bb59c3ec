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
        Standard deviation of a post's error, independent from post to post, m.
    """

    grid: Grid
    elevation: Array
    sigma: float

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
