"""Sloping terrain as a plane, and coordinates in which it is horizontal.

Measuring heights from the plane makes it horizontal without lateral displacement and keeps straight
lines straight. A shadow on a slope thus equals one on horizontal terrain under a higher or lower
Sun, seen from a steeper or flatter direction. Models for horizontal terrain then apply, if rocks
stand upright on either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.models.pinhole import View
from lunarsim.typing import Array


class LevelledView(View):
    """Camera view in coordinates in which a sloping plane is horizontal.

    In these coordinates `axes` is not a rotation matrix.
    """

    @property
    def enu_to_sensor(self) -> Array:
        """Matrix (3, 3) from the levelled coordinates to sensor axes."""
        return np.asarray(np.linalg.inv(self.axes))


@dataclass(frozen=True)
class GroundPlane:
    """Plane that approximates the terrain, with coordinates in which it is horizontal.

    Attributes
    ----------
    height
        Height of the plane at the origin of the frame, m.
    gradient
        Slope to the east and to the north (2,), tangents.
    """

    height: float
    gradient: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def through(cls, point: ArrayLike, gradient: ArrayLike) -> GroundPlane:
        """Return the plane with a gradient (2,) through a point (3,), ENU, m."""
        east, north, up = (float(x) for x in np.asarray(point, np.float64))
        rise_east, rise_north = (float(g) for g in np.asarray(gradient, np.float64))
        return cls(up - rise_east * east - rise_north * north, (rise_east, rise_north))

    @property
    def is_horizontal(self) -> bool:
        """Whether the plane is horizontal."""
        return self.gradient == (0.0, 0.0)

    def heights(self, xy: Array) -> Array:
        """Return the heights of the plane (n,) at points (n, 2), m.

        `xy` is east and north.
        """
        return np.asarray(self.height + xy @ np.array(self.gradient))

    def level_vectors(self, vectors: Array) -> Array:
        """Return vectors (..., 3), ENU, in coordinates in which the plane is horizontal.

        The rise of the plane along each vector is subtracted from its vertical component.
        """
        out = np.array(vectors, np.float64)
        out[..., 2] -= out[..., :2] @ np.array(self.gradient)
        return out

    def level_direction(self, vector: Array) -> Array:
        """Return a direction (3,), ENU, in coordinates in which the plane is horizontal.

        The result has unit length.
        """
        if self.is_horizontal:
            return np.asarray(vector)
        out = self.level_vectors(vector)
        return np.asarray(out / np.linalg.norm(out))

    def level_points(self, points: Array) -> Array:
        """Return points (..., 3), ENU, with heights above the plane instead of z, m."""
        out = self.level_vectors(points)
        out[..., 2] -= self.height
        return out

    def equivalent_pixel(self, pixel: Array, to_camera: Array, levelled_to_camera: Array) -> Array:
        """Return the pixel sizes (...), m, for models of horizontal terrain.

        Such models get the depression of the line of sight in levelled coordinates. With the size
        returned, they predict as many pixels as a patch covers on the plane.

        Parameters
        ----------
        pixel
            Pixel size across the lines of sight (...), m.
        to_camera, levelled_to_camera
            Vectors to the camera (..., 3), m, in ENU and in levelled coordinates.
        """
        longer = np.linalg.norm(to_camera, axis=-1) / np.linalg.norm(levelled_to_camera, axis=-1)
        return np.asarray(pixel * np.sqrt(longer))

    def level_view(self, view: View) -> View:
        """Return a camera view in coordinates with the plane horizontal at height 0."""
        position = self.level_points(view.position)
        if self.is_horizontal:
            return replace(view, position=position)
        return LevelledView(
            position, self.level_vectors(view.axes.T).T,
            view.fx, view.fy, view.cx, view.cy, view.width, view.height,
        )  # fmt: skip


LEVEL = GroundPlane(0.0)
