"""Bounds of the part of a shadow map that an image reads.

The map is a rectangle along the Sun's azimuth around everything visible. An image whose footprint
is oblique to it, or extends to one side, reads only a part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.models.pinhole import View
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.typing import Array, BoolArray

# Neighbourhood in texels that a shader may read, with a margin for the rounding of float32.
_NEIGHBOURHOOD = 3.0
# Coarse relief displaces points along their rays, twice by at most 0.4 % of the range
# (`shade_fragment.glsl`); the remainder covers the resolution of the depth buffer.
_DISPLACEMENT = 0.01
# Minimum descent of a ray per metre for which the reads are bounded.
_MIN_DESCENT = 1e-3

# Edges of the body of rays between two elevations; its points are numbered by ray (around the
# image) and elevation.
_EDGES = np.array(
    [[2 * k + j, 2 * ((k + 1) % 4) + j] for k in range(4) for j in range(2)]
    + [[2 * k, 2 * k + 1] for k in range(4)]
)


@dataclass(frozen=True)
class ShadowMapReads:
    """Part of a shadow map that an image reads: intersection of strips, and border.

    Attributes
    ----------
    normal
        Unit normals of the strips (k, 2), map axes; empty if any texel may be read.
    lower_bound, upper_bound
        Bounds of the strips along their normals (k,), texels.
    size
        Size of the map along its axes, texels.
    """

    normal: Array
    lower_bound: Array
    upper_bound: Array
    size: tuple[int, int]

    @classmethod
    def anywhere(cls, frame: ShadowFrame) -> ShadowMapReads:
        """Return reads without strips: the image may read any texel of the map."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0), frame.size)

    @classmethod
    def of(cls, view: View, frame: ShadowFrame, lowest: float, highest: float) -> ShadowMapReads:
        """Return the strips of a shadow map that a view reads.

        The view shows only points between the elevations `lowest` and `highest`, m. If the camera
        is not above them, or a corner ray of the view does not descend, the view may read any
        texel.
        """
        drop = float(view.position[2]) - lowest
        top = highest + _DISPLACEMENT * drop
        left, right, upper, lower = view.border_tangents
        border = np.array([[left, upper, 1.0], [right, upper, 1.0], [right, lower, 1.0],
                           [left, lower, 1.0]]) @ view.axes.T  # fmt: skip
        steep = -border[:, 2] > _MIN_DESCENT * np.linalg.norm(border, axis=1)
        if not steep.all() or top >= view.position[2]:
            return cls.anywhere(frame)
        levels = np.array([-(1.0 + _DISPLACEMENT) * drop, top - view.position[2]])
        points = (border[:, None] * (levels / border[:, 2:])[..., None]).reshape(-1, 3)
        place = frame.texels_of(points)
        edge = place[_EDGES[:, 1]] - place[_EDGES[:, 0]]
        normal = np.column_stack((-edge[:, 1], edge[:, 0]))
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-9)[:, None]
        along = place @ normal.T
        room = _NEIGHBOURHOOD * np.abs(normal).sum(axis=1)
        return cls(normal, along.min(axis=0) - room, along.max(axis=0) + room, frame.size)

    def may_shade(self, corners: Array) -> BoolArray:
        """Return which convex bodies (n,) may shadow texels that the image reads.

        `corners` (n, c, 2) are the c corners of each body on the map, in texels.
        """
        along = corners @ self.normal.T
        within = ((along.max(1) >= self.lower_bound) & (along.min(1) <= self.upper_bound)).all(-1)
        # A point outside the map reads its border.
        last = np.array(self.size) - _NEIGHBOURHOOD - 1.0
        border = ((corners.min(1) < _NEIGHBOURHOOD + 1.0) | (corners.max(1) > last)).any(-1)
        return np.asarray(within | border)
