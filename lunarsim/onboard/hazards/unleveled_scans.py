"""Terrain mapped before the tilt of the lander was known, which is rotated later."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.mapper import NEGLIGIBLE_TILT_RAD

Array = NDArray[np.float64]


class UnleveledScans:
    """Decide which measurements must be rotated when the tilt is corrected.

    These are all measurements from the first scan until the first scan whose tilt is known to
    `NEGLIGIBLE_TILT_RAD`. They share one tilt error; later measurements are placed correctly.
    """

    def __init__(self) -> None:
        self._open = True

    def includes(self, tilt_sigma: float) -> bool:
        """Return whether a measurement with this tilt uncertainty must be rotated later.

        Parameters
        ----------
        tilt_sigma
            Standard deviation of the tilt, rad; NaN if unknown.
        """
        self._open = self._open and not tilt_sigma <= NEGLIGIBLE_TILT_RAD  # NaN: unknown
        return self._open

    def is_tilt_known(self, tilt_sigma: float) -> bool:
        """Return whether the tilt is known, so that rotated measurements become final.

        Parameters
        ----------
        tilt_sigma
            Standard deviation of the tilt, rad; NaN if unknown.
        """
        self._open = self._open and not tilt_sigma <= NEGLIGIBLE_TILT_RAD
        return tilt_sigma <= NEGLIGIBLE_TILT_RAD


def rotate_about(points: Array, turn: Array, pivot: Array) -> Array:
    """Return points (..., 3) rotated by a matrix (3, 3) about a pivot (3,)."""
    return np.asarray((points - pivot) @ turn.T + pivot)
