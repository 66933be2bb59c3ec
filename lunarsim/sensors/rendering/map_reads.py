"""`MapReads`: where in a shadow map a picture looks.

The map is a rectangle along the Sun's azimuth about all that the picture shows, so a picture that
lies askew of it, or one that runs off to a side, never looks into much of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.pinhole import View
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame

Array = NDArray[np.float64]

# Texels about a place that a shader may read, with room for what float32 loses.
_ABOUT = 3.0
# Where the relief is drawn coarsely its points move along their rays, twice by 0.4 % of the range
# at most (`shade_fragment.glsl`); the rest is for the steps of the depth that is read back.
_MENDED = 0.01
# The least drop of a ray for each metre, for the map's reads to be bounded at all.
_LEVEL = 1e-3

# The edges of the body of rays between two levels: its points are numbered by ray (around the
# picture) and level.
_EDGES = np.array(
    [[2 * k + j, 2 * ((k + 1) % 4) + j] for k in range(4) for j in range(2)]
    + [[2 * k, 2 * k + 1] for k in range(4)]
)


@dataclass(frozen=True)
class MapReads:
    """Strips of a shadow map in all of which a picture's points lie, unless on the map's border.

    Attributes
    ----------
    normal
        Unit normals of the strips (k, 2), in the map's axes; none where anything may be read.
    least, most
        Bounds of the strips along their normals (k,), texels.
    size
        Texels of the map along its axes.
    """

    normal: Array
    least: Array
    most: Array
    size: tuple[int, int]

    @classmethod
    def anywhere(cls, frame: ShadowFrame) -> MapReads:
        """Return the reads of a picture of which nothing is known."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0), frame.size)

    @classmethod
    def of(cls, view: View, frame: ShadowFrame, lowest: float, highest: float) -> MapReads:
        """Return the reads of a view that shows points between two elevations alone, m."""
        drop = float(view.position[2]) - lowest
        top = highest + _MENDED * drop
        left, right, upper, lower = view.border
        border = np.array([[left, upper, 1.0], [right, upper, 1.0], [right, lower, 1.0],
                           [left, lower, 1.0]]) @ view.axes.T  # fmt: skip
        steep = -border[:, 2] > _LEVEL * np.linalg.norm(border, axis=1)
        if not steep.all() or top >= view.position[2]:
            return cls.anywhere(frame)
        levels = np.array([-(1.0 + _MENDED) * drop, top - view.position[2]])
        points = (border[:, None] * (levels / border[:, 2:])[..., None]).reshape(-1, 3)
        place = frame.texels_of(points)
        edge = place[_EDGES[:, 1]] - place[_EDGES[:, 0]]
        normal = np.column_stack((-edge[:, 1], edge[:, 0]))
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-9)[:, None]
        along = place @ normal.T
        room = _ABOUT * np.abs(normal).sum(axis=1)
        return cls(normal, along.min(axis=0) - room, along.max(axis=0) + room, frame.size)

    def meet(self, place: Array) -> NDArray[np.bool_]:
        """Return which convex bodies with corners (n, c, 2), in texels, may darken what is read."""
        along = place @ self.normal.T
        within = ((along.max(1) >= self.least) & (along.min(1) <= self.most)).all(-1)
        # A point beyond the map reads its border.
        last = np.array(self.size) - _ABOUT - 1.0
        border = ((place.min(1) < _ABOUT + 1.0) | (place.max(1) > last)).any(-1)
        return np.asarray(within | border)
