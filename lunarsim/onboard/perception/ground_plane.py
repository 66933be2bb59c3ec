"""Sloping terrain as a plane, and coordinates in which it is horizontal.

Measuring heights from the plane makes it horizontal without lateral displacement and keeps straight
lines straight. A shadow on a slope thus equals one on horizontal terrain under a higher or lower
Sun, seen from a steeper or flatter direction. Models for horizontal terrain then apply, if rocks
stand upright on either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.models.pinhole import View

Array = NDArray[np.float64]


class LevelledView(View):
    """View in coordinates that make a sloping plane horizontal; `axes` is no rotation."""

    @property
    def into(self) -> Array:
        """Matrix (3, 3) from these coordinates to the sensor's."""
        return np.asarray(np.linalg.inv(self.axes))


@dataclass(frozen=True)
class GroundPlane:
    """Plane that approximates the terrain.

    Attributes
    ----------
    height
        Height at the origin, m.
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
    def level(self) -> bool:
        """Whether the plane is horizontal."""
        return self.gradient == (0.0, 0.0)

    def heights(self, xy: Array) -> Array:
        """Return the heights of the plane (n,) at points (n, 2), m."""
        return np.asarray(self.height + xy @ np.array(self.gradient))

    def levelled(self, vectors: Array) -> Array:
        """Return vectors (..., 3), ENU, minus the rise of the plane along them."""
        out = np.array(vectors, np.float64)
        out[..., 2] -= out[..., :2] @ np.array(self.gradient)
        return out

    def direction(self, vector: Array) -> Array:
        """Return a direction (3,) in coordinates with the plane horizontal, unit length."""
        if self.level:
            return np.asarray(vector)
        out = self.levelled(vector)
        return np.asarray(out / np.linalg.norm(out))

    def points(self, points: Array) -> Array:
        """Return points (..., 3) with heights measured from the plane, m."""
        out = self.levelled(points)
        out[..., 2] -= self.height
        return out

    def seen_pixel(self, pixel: Array, away: Array, levelled: Array) -> Array:
        """Return pixel sizes (...), m, at which horizontal terrain appears as this plane.

        Of two equal patches of terrain, the one that is seen more steeply and from nearby covers
        more pixels. Models for horizontal terrain use the depression in levelled coordinates.

        Parameters
        ----------
        pixel
            Pixel size across the lines of sight (...), m.
        away, levelled
            Vectors to the camera (..., 3), as they are and levelled, m.
        """
        longer = np.linalg.norm(away, axis=-1) / np.linalg.norm(levelled, axis=-1)
        return np.asarray(pixel * np.sqrt(longer))

    def view(self, view: View) -> View:
        """Return a view in coordinates with the plane horizontal at height 0."""
        position = self.points(view.position)
        if self.level:
            return replace(view, position=position)
        return LevelledView(
            position, self.levelled(view.axes.T).T,
            view.fx, view.fy, view.cx, view.cy, view.width, view.height,
        )  # fmt: skip


LEVEL = GroundPlane(0.0)
