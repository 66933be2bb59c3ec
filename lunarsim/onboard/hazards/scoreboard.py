"""Landing sites ranked by a mapper itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.typing import Array
from lunarsim.value_checks import check_elements, check_shape


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
        check_shape("scoreboard.position", self.position, (n, 3), f"for {n} scores")
        for name in ("position", "score", "current_site_score"):
            values = np.asarray(getattr(self, name))
            check_elements(f"scoreboard.{name}", values, ~np.isnan(values), "must not be NaN")
