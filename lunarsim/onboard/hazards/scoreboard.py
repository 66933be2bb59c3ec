"""Landing sites ranked by a mapper itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scoreboard:
    """Landing sites ranked by a mapper's own score (quadtree paper, section 4).

    The sites are in order of their score, best first.

    Attributes
    ----------
    position
        Terrain points at the sites (n, 3), local frame, m.
    score
        Score of each site (n,), lower is better; Eq. 9 of the quadtree paper for the quadtree
        mapper.
    current_site_score
        Score of the current target site; inf if it is not eligible or was not evaluated.

    Raises
    ------
    InputError
        If shapes differ, or a score or position is NaN.
    """

    position: Array
    score: Array
    current_site_score: float = float("inf")

    def __post_init__(self) -> None:
        n = len(self.score)
        if np.shape(self.position) != (n, 3):
            raise InputError(
                "scoreboard.position", np.shape(self.position), f"must have shape ({n}, 3)"
            )
        for name in ("position", "score", "current_site_score"):
            if np.isnan(getattr(self, name)).any():
                raise InputError(f"scoreboard.{name}", "NaN", "must be a number")
