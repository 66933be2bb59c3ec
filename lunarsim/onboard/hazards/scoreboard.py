"""Sites that a mapper has ranked itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scoreboard:
    """The best sites by a mapper's own score, best first (quadtree paper, section 4).

    Attributes
    ----------
    position
        Ground at the sites (n, 3), local frame, m.
    score
        The less the better (n,); for the quadtree Eq. 9.
    here
        Score of the site flown to now; inf where it is not eligible or was not judged.

    Raises
    ------
    InputError
        If shapes differ, or a score or position is NaN.
    """

    position: Array
    score: Array
    here: float = float("inf")

    def __post_init__(self) -> None:
        n = len(self.score)
        if np.shape(self.position) != (n, 3):
            raise InputError("scoreboard.position", np.shape(self.position), f"shape ({n}, 3)")
        for name in ("position", "score", "here"):
            if np.isnan(getattr(self, name)).any():
                raise InputError(f"scoreboard.{name}", "NaN", "numbers")
