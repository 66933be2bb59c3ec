"""How scans are compared with a map and with each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.registration import Fit


@dataclass(frozen=True)
class RegistrationSettings:
    """How scans are compared with the map and with each other.

    Attributes
    ----------
    model_sigma
        What else sets a scan's mean over a post's square apart from the post: rocks that hide the
        ground behind them, points that lie unevenly, m.
    least_squares
        Fewest squares for a registration.
    least_share
        Least share of them that must agree with the map.
    greatest_misfit
        Mean square of their residuals, in units of their variance, above which there is no match.
    chance, map_chance
        Of a good correction to be refused: by a scan kept or a search, and by a fit to the map,
        where ground that has changed in part draws a fit aside by a few deviations.
    certainty
        Probability of the best place that a search must reach to be believed.
    level_sigma
        Of a height taken from the level of the ground before the place is known, m.
    search_s
        Between two searches, s.
    lost_s
        If nothing that covers posts enough agrees for so long the lock is lost, s.
    gather_s
        Scans that cover too few posts are gathered for so long at most, s.
    odometry_postings
        Least and greatest squares in which scans are compared with each other, m: a
        twenty-fourth of a scan's width between them.
    odometry_sigma
        Of the difference of their heights there, m.
    key_share
        A scan is compared with an earlier one until less than this share of it lies on that one.

    Raises
    ------
    InputError
        If one is out of range.
    """

    model_sigma: float = 0.03
    least_squares: int = 12
    least_share: float = 0.7
    greatest_misfit: float = 1.6
    chance: float = 4e-5
    map_chance: float = 1e-3
    certainty: float = 0.99999
    level_sigma: float = 0.5
    search_s: float = 0.5
    lost_s: float = 2.0
    gather_s: float = 5.0
    odometry_postings: tuple[float, float] = (0.05, 0.4)
    odometry_sigma: float = 0.03
    key_share: float = 0.8

    def __post_init__(self) -> None:
        if not (
            np.shape(self.odometry_postings) == (2,)
            and 0.0 < self.odometry_postings[0] <= self.odometry_postings[1] < np.inf
        ):
            raise InputError(
                "navigation.odometry_postings",
                self.odometry_postings,
                "two lengths, the least first",
            )
        for name in ("least_share", "chance", "map_chance", "certainty", "key_share"):
            value = getattr(self, name)
            if not 0.0 < value <= 1.0:
                raise InputError(f"navigation.{name}", value, "above 0 and at most 1")
        for name in ("model_sigma", "least_squares", "greatest_misfit", "level_sigma", "search_s",
                     "lost_s", "gather_s", "odometry_sigma"):  # fmt: skip
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise InputError(f"navigation.{name}", value, "a positive number")

    def believes(self, found: Fit) -> bool:
        """Tell whether enough agrees, and well enough."""
        return (
            found.used >= self.least_squares
            and found.share >= self.least_share
            and found.misfit <= self.greatest_misfit
        )
