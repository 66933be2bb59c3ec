"""Settings of the scan registration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.registration import MapFit


@dataclass(frozen=True)
class RegistrationSettings:
    """Settings of the registration of scans on a map and on each other.

    Attributes
    ----------
    model_sigma
        Standard deviation of the difference between the mean height of a scan over the cell of a
        map grid point and the map height, apart from the map's noise, m. Causes are occlusion by
        rocks and uneven sampling.
    min_squares
        Minimum number of grid squares with scan heights for a registration.
    min_agreement
        Minimum fraction of squares that agree with the map.
    max_misfit
        Maximum mean square of the residuals of agreeing squares, in units of their variance.
    rejection_probability, map_rejection_probability
        Probability to reject a valid correction, from a reference scan or a search
        (`rejection_probability`) and from a fit to the map (`map_rejection_probability`). Partly
        changed terrain biases a fit to the map by a few standard deviations.
    certainty
        Minimum probability of the best place of a search.
    height_sigma
        Standard deviation of a height that is derived before the place is known, m.
    search_s
        Time between two searches, s.
    lost_s
        Time without agreement of a large enough scan after which the lock is lost, s.
    max_accumulation_s
        Maximum time over which small scans are accumulated, s.
    odometry_postings
        Minimum and maximum side of the squares for scan-to-scan odometry, m. Between these limits
        the side is 1/24 of the width of a scan.
    odometry_sigma
        Standard deviation of the height difference of two scans in a square, m.
    min_overlap
        Minimum overlap with the reference scan; below it the reference scan is replaced.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    model_sigma: float = 0.03
    min_squares: int = 12
    min_agreement: float = 0.7
    max_misfit: float = 1.6
    rejection_probability: float = 4e-5
    map_rejection_probability: float = 1e-3
    certainty: float = 0.99999
    height_sigma: float = 0.5
    search_s: float = 0.5
    lost_s: float = 2.0
    max_accumulation_s: float = 5.0
    odometry_postings: tuple[float, float] = (0.05, 0.4)
    odometry_sigma: float = 0.03
    min_overlap: float = 0.8

    def __post_init__(self) -> None:
        if not (
            np.shape(self.odometry_postings) == (2,)
            and 0.0 < self.odometry_postings[0] <= self.odometry_postings[1] < np.inf
        ):
            raise InputError(
                "navigation.odometry_postings",
                self.odometry_postings,
                "must be two positive lengths, the shorter length first",
            )
        for name in (
            "min_agreement",
            "rejection_probability",
            "map_rejection_probability",
            "certainty",
            "min_overlap",
        ):
            value = getattr(self, name)
            if not 0.0 < value <= 1.0:
                raise InputError(f"navigation.{name}", value, "must be more than 0 and at most 1")
        for name in ("model_sigma", "min_squares", "max_misfit", "height_sigma", "search_s",
                     "lost_s", "max_accumulation_s", "odometry_sigma"):  # fmt: skip
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise InputError(f"navigation.{name}", value, "must be positive and finite")

    def accepts_fit(self, fit: MapFit) -> bool:
        """Return whether a fit is good: enough grid squares agree, with small residuals."""
        return (
            fit.used >= self.min_squares
            and fit.agreeing_fraction >= self.min_agreement
            and fit.misfit <= self.max_misfit
        )
