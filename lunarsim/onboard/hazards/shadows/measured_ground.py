"""Ground that another mapper of the lander has measured: its plane, and its heights."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import Surface
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.hazards.shadows.relief_plane import relief_plane
from lunarsim.onboard.perception.ground_plane import GroundPlane

Array = NDArray[np.float64]

# A rock stands on the mean height of the ground within so much of it to either side, m: its own top
# and what a single return errs by count little.
_ABOUT = 1.0


class MeasuredGround:
    """What a mapper of elevations has measured, as it stands.

    Parameters
    ----------
    mapper
        Whose ground it is; None: nobody measures any.
    """

    def __init__(self, mapper: HazardMapper | None) -> None:
        self._mapper = mapper
        self._of: Surface | None = None
        self._plane: GroundPlane | None = None
        self._heights: Array | None = None
        self._anew = False

    def anew(self) -> bool:
        """Tell whether it was drawn anew since last asked: after a scan, or laid or turned anew."""
        self._drawn()
        anew, self._anew = self._anew, False
        return anew

    def plane(self) -> GroundPlane | None:
        """Return the plane of it; None where too little was measured, see `relief_plane`."""
        self._drawn()
        return self._plane

    def heights(self, xy: Array) -> Array:
        """Return its heights (n,) at points (n, 2), local frame, m; NaN where none was measured.

        Each is the mean over a square of 2 m about the point's cell, of what is known there.
        """
        out = np.full(len(xy), np.nan)
        drawn = self._drawn()
        if drawn is None or self._heights is None:
            return out
        at = np.flatnonzero(np.isfinite(xy).all(1))
        at = at[drawn.grid.contains(xy[at])]
        out[at] = self._heights[drawn.grid.cell(xy[at])]
        return out

    def _drawn(self) -> Surface | None:
        """Return the mapper's surface, and work out once what is asked of it."""
        if self._mapper is None:
            return None
        drawn = self._mapper.surface()
        if drawn is not self._of:
            self._of, self._plane, self._heights = drawn, relief_plane(drawn), _smoothed(drawn)
            self._anew = True
        return drawn


def _smoothed(drawn: Surface) -> Array | None:
    """Return the mean of known elevations about each cell that has one (rows, cols), m.

    NaN elsewhere; None if none is known.
    """
    if drawn.elevation is None:
        return None
    known = np.isfinite(drawn.elevation)
    if not known.any():
        return None
    side = 2 * max(1, round(_ABOUT / drawn.grid.posting)) + 1
    total, share = (
        cv2.blur(of, (side, side), borderType=cv2.BORDER_CONSTANT)
        for of in (np.where(known, drawn.elevation, 0.0).astype(np.float64), known.astype(float))
    )
    return np.where(known, total / np.where(known, share, 1.0), np.nan)
