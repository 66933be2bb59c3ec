"""Motion of stored map positions in the local frame, following the rocks.

Rocks are positioned relative to the lander, so later corrections of position and attitude move the
rocks: by 1 m or more on a descent that knows them to 0.1 m relative to the lander. Evidence about
the terrain between the rocks must move with them.
"""

from __future__ import annotations

import numpy as np

from lunarsim.typing import Array

# Prior against rotation and scale, equivalent to this many rocks at this distance (m): few rocks
# only shift the map.
_PRIOR_ROCK_COUNT, _PRIOR_DISTANCE_M = 10.0, 20.0
# Rocks whose motion deviates by more than this many median deviations are ignored.
_OUTLIER_DEVIATIONS = 4.0
# Minimum of the median deviation, m.
_MIN_DEVIATION_M = 0.005


class MapMotion:
    """Motion of stored map positions in the local frame, as an affine transformation.

    The positions follow the tracked rocks, which navigation corrections move.

    Parameters
    ----------
    centre
        Centre of the positions, east and north (2,), m.
    """

    def __init__(self, centre: Array) -> None:
        self._centre = np.asarray(centre, dtype=np.float64)
        self._shift = np.zeros(2)
        self._turn = np.eye(2)

    def forget(self) -> None:
        """Reset the motion, so that stored and current positions are equal."""
        self._shift = np.zeros(2)
        self._turn = np.eye(2)

    @property
    def is_identity(self) -> bool:
        """Whether stored and current positions are equal."""
        return not self._shift.any() and np.array_equal(self._turn, np.eye(2))

    def follow(self, xy: Array, motion: Array) -> None:
        """Move the stored positions with the tracked rocks.

        Rocks whose motion deviates from that of most rocks are ignored. Without a rock of known
        motion, nothing changes.

        Parameters
        ----------
        xy
            Current positions of the rocks (n, 2), m.
        motion
            Motion of the rocks since the last call (n, 2), m; NaN if unknown.
        """
        known = np.isfinite(motion).all(1) & np.isfinite(xy).all(1)
        xy, motion = xy[known], motion[known]
        if len(xy) == 0:
            return
        off = np.hypot(*(motion - np.median(motion, axis=0)).T)
        is_inlier = off <= _OUTLIER_DEVIATIONS * max(float(np.median(off)), _MIN_DEVIATION_M)
        before, motion = (xy - motion)[is_inlier], motion[is_inlier]
        centre, shift = before.mean(0), motion.mean(0)
        arm = before - centre
        square = arm.T @ arm + _PRIOR_ROCK_COUNT * _PRIOR_DISTANCE_M**2 * np.eye(2)
        turn = np.linalg.solve(square, arm.T @ (motion - shift)).T
        # The motion of an old position is shift + turn @ (position - centre).
        self._shift = self._shift + shift + turn @ (self._centre + self._shift - centre)
        self._turn = self._turn + turn @ self._turn

    def to_current(self, stored: Array) -> Array:
        """Convert stored positions (..., 2), m, to current positions in the local frame."""
        away = np.asarray(stored, dtype=np.float64) - self._centre
        return np.asarray(self._centre + self._shift + away @ self._turn.T)

    def to_stored(self, current: Array) -> Array:
        """Convert current positions (..., 2), m, in the local frame to stored positions."""
        away = np.asarray(current, dtype=np.float64) - self._centre - self._shift
        return np.asarray(self._centre + away @ np.linalg.inv(self._turn).T)
