"""Terrain mapped before the tilt of the lander was known, which is rotated later."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.hazards.mapper import NEGLIGIBLE_TILT_RAD
from lunarsim.typing import Array


class UnleveledScans:
    """Decide which scans must be rotated when navigation corrects the tilt estimate.

    These are all scans before the first scan whose tilt is known to `NEGLIGIBLE_TILT_RAD`. They
    share one tilt error; later scans are placed correctly.
    """

    def __init__(self) -> None:
        self._open = True

    def includes(self, tilt_sigma: float) -> bool:
        """Return whether a scan with this tilt uncertainty must be rotated later.

        After the first scan with a known tilt, the result is False for all scans.

        Parameters
        ----------
        tilt_sigma
            Standard deviation of the tilt, rad; NaN if unknown.
        """
        self._open = self._open and not tilt_sigma <= NEGLIGIBLE_TILT_RAD  # NaN: unknown
        return self._open

    def is_tilt_known(self, tilt_sigma: float) -> bool:
        """Return whether the tilt is known, so that rotated scans become final.

        If it is, `includes` returns False for all later scans.

        Parameters
        ----------
        tilt_sigma
            Standard deviation of the tilt, rad; NaN if unknown.
        """
        self._open = self._open and not tilt_sigma <= NEGLIGIBLE_TILT_RAD
        return tilt_sigma <= NEGLIGIBLE_TILT_RAD


def rotate_about(points: Array, turn: Array, pivot: Array) -> Array:
    """Rotate points (..., 3), m, about a pivot (3,) by the rotation matrix `turn`."""
    return np.asarray((points - pivot) @ turn.T + pivot)
