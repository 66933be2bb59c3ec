"""How what was noted of places slides through the local frame, as rocks do.

Rocks are placed from the lander, so what corrects its place and attitude later moves the rocks with
it: by a metre and more on a descent that knows them to a decimetre from the lander. What a picture
showed of the ground between them belongs to the ground, so it must move as they do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# So many rocks at such a distance (m) speak for a turn or a stretch of the ground as loudly as
# nothing does against it: few rocks move it as a whole.
_PRIOR_ROCK_COUNT, _PRIOR_DISTANCE_M = 10.0, 20.0
# Rocks that move otherwise than the rest by so many median deviations are left out.
_OUTLIER_DEVIATIONS = 4.0
# Median deviation that no motion of a rock falls below, m.
_MIN_DEVIATION_M = 0.005


class MapMotion:
    """The motion of noted places: one affine map of the plane.

    Parameters
    ----------
    middle
        East and north of the middle of the places (2,), m.
    """

    def __init__(self, middle: Array) -> None:
        self._centre = np.asarray(middle, dtype=np.float64)
        self._shift = np.zeros(2)
        self._turn = np.eye(2)

    def forget(self) -> None:
        """Let places lie where they were noted."""
        self._shift = np.zeros(2)
        self._turn = np.eye(2)

    @property
    def still(self) -> bool:
        """Whether places lie where they were noted."""
        return not self._shift.any() and np.array_equal(self._turn, np.eye(2))

    def follow(self, xy: Array, by: Array) -> None:
        """Move places as rocks were moved.

        Parameters
        ----------
        xy
            Where the rocks stand now (n, 2), m.
        by
            By how far they were moved (n, 2), m; NaN for rocks that tell nothing.
        """
        known = np.isfinite(by).all(1) & np.isfinite(xy).all(1)
        xy, by = xy[known], by[known]
        if len(xy) == 0:
            return
        off = np.hypot(*(by - np.median(by, axis=0)).T)
        is_inlier = off <= _OUTLIER_DEVIATIONS * max(float(np.median(off)), _MIN_DEVIATION_M)
        before, by = (xy - by)[is_inlier], by[is_inlier]
        centre, shift = before.mean(0), by.mean(0)
        arm = before - centre
        square = arm.T @ arm + _PRIOR_ROCK_COUNT * _PRIOR_DISTANCE_M**2 * np.eye(2)
        turn = np.linalg.solve(square, arm.T @ (by - shift)).T
        # Where a place lay before, it is moved by shift + turn @ (place - centre).
        self._shift = self._shift + shift + turn @ (self._centre + self._shift - centre)
        self._turn = self._turn + turn @ self._turn

    def now(self, noted: Array) -> Array:
        """Return where noted places (..., 2) lie now, m."""
        away = np.asarray(noted, dtype=np.float64) - self._centre
        return np.asarray(self._centre + self._shift + away @ self._turn.T)

    def noted(self, now: Array) -> Array:
        """Return where places (..., 2) that now lie there were noted, m."""
        away = np.asarray(now, dtype=np.float64) - self._centre - self._shift
        return np.asarray(self._centre + away @ np.linalg.inv(self._turn).T)
