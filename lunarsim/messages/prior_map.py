"""Elevation map known before the flight: coarse, noisy, partly outdated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.typing import Array


@dataclass(frozen=True)
class PriorMap:
    """Elevation map known before the flight, with the statistics of its errors.

    The elevation at a grid point is the mean over the square cell around the point.

    Attributes
    ----------
    grid
        Grid of the map in the site frame.
    elevation
        Elevations (rows, cols), m; NaN where the map has no data.
    sigma
        Standard deviation of the elevation error at a grid point, m.
    correlation
        Correlation length of the errors, m: at this distance their correlation is exp(-1/2);
        0: independent errors.
    """

    grid: Grid
    elevation: Array
    sigma: float
    correlation: float = 0.0

    def __post_init__(self) -> None:
        if self.elevation.shape != self.grid.shape:
            raise InputError(
                "prior.elevation",
                self.elevation.shape,
                f"must have the shape {self.grid.shape} of its grid",
            )
        if np.isinf(self.elevation).any():
            raise InputError(
                "prior.elevation", self.elevation, "must not contain infinite values",
                "Use NaN where there is no data.", show_value=False,
            )  # fmt: skip
        if np.isnan(self.elevation).all():
            raise InputError(
                "prior.elevation", self.elevation, "must not be NaN everywhere", show_value=False
            )
        if not (np.isfinite(self.sigma) and self.sigma > 0.0):
            raise InputError("prior.sigma_m", self.sigma, "must be positive and finite")
        if not (np.isfinite(self.correlation) and self.correlation >= 0.0):
            raise InputError(
                "prior.correlation_m", self.correlation, "must be 0 or more and finite"
            )

    @property
    def equivalent_correlated_posts(self) -> float:
        """Number of neighbouring grid points that count as one independent error.

        It is the sum of the error correlations of one grid point with all grid points; the
        correlation is a Gaussian function of distance over `correlation`.
        """
        reach = self.correlation / self.grid.posting
        if reach == 0.0:
            return 1.0
        n = np.arange(1.0, np.ceil(5.0 * reach) + 1.0)
        return float((1.0 + 2.0 * np.exp(-0.5 * (n / reach) ** 2).sum()) ** 2)
