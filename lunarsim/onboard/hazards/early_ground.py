"""Ground that was mapped before the lander's tilt was known, and turns when it is learnt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.mapper import SURE_TILT

Array = NDArray[np.float64]


class EarlyGround:
    """Tells which of what a mapper takes in is to turn with the tilt.

    That is all from the first scan on, until one comes with a tilt known to `SURE_TILT`: scans
    before agree with each other and err by one tilt, later ones lie where they are.
    """

    def __init__(self) -> None:
        self._open = True

    def takes(self, tilt_sigma: float) -> bool:
        """Tell whether what comes with a tilt known so well (rad) is to turn with those before."""
        self._open = self._open and not tilt_sigma <= SURE_TILT  # NaN: not known
        return self._open

    def known(self, tilt_sigma: float) -> bool:
        """Tell whether what was turned stays where it is from now on."""
        self._open = self._open and not tilt_sigma <= SURE_TILT
        return tilt_sigma <= SURE_TILT


def turned_about(points: Array, turn: Array, pivot: Array) -> Array:
    """Return points (..., 3) turned by (3, 3) about a pivot (3,)."""
    return np.asarray((points - pivot) @ turn.T + pivot)
