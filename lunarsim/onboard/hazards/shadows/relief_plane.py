"""Ground that another mapper of the lander has measured, as the plane on which rocks stand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.perception.ground_plane import GroundPlane

# So much of a map must have been seen, and no ground is steeper than this, tangent.
_LEAST_SEEN, _STEEPEST = 0.25, 0.3
# About so many cells along a side are looked at.
_CELLS = 40


def relief_plane(drawn: HazardMap) -> GroundPlane | None:
    """Return the plane through the elevations of a map by least squares.

    None where too little of it was seen, or it seems steeper than ground that is landed on.
    """
    if drawn.elevation is None:
        return None
    step = max(1, min(drawn.grid.shape) // _CELLS)
    height = drawn.elevation[::step, ::step]
    seen: NDArray[np.bool_] = drawn.observed[::step, ::step] & np.isfinite(height)
    if seen.mean() < _LEAST_SEEN:
        return None
    x, y = np.meshgrid(drawn.grid.x[::step], drawn.grid.y[::step])
    middle = np.array([x[seen].mean(), y[seen].mean()])
    terms = np.column_stack((x[seen] - middle[0], y[seen] - middle[1], np.ones(seen.sum())))
    east, north, up = np.linalg.lstsq(terms, height[seen])[0]
    if np.hypot(east, north) > _STEEPEST:
        return None
    return GroundPlane.through((*middle, up), (east, north))


class MeasuredPlane:
    """The plane of what a mapper of elevations has measured, as it stands.

    Parameters
    ----------
    mapper
        Whose ground it is; None: nobody measures any.
    """

    def __init__(self, mapper: HazardMapper | None) -> None:
        self._mapper = mapper
        self._of: HazardMap | None = None
        self._plane: GroundPlane | None = None

    def plane(self) -> GroundPlane | None:
        """Return it; None where too little was measured, see `relief_plane`."""
        if self._mapper is None:
            return None
        drawn = self._mapper.hazard_map()
        if drawn is not self._of:
            self._of, self._plane = drawn, relief_plane(drawn)
        return self._plane
