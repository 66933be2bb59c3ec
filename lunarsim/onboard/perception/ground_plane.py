"""Ground that slopes, as a plane, and coordinates in which it is level.

Heights counted from the plane turn it level and move no point to the side; straight lines stay
straight. So a shadow on a slope is that on level ground under a Sun that stands higher or lower,
seen from a camera whose lines of sight are steeper or flatter: what is known of shadows on level
ground holds, if rocks stand upright on either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.models.pinhole import View

Array = NDArray[np.float64]


class LevelledView(View):
    """A view in coordinates in which sloping ground is level: `axes` are no rotation there."""

    @property
    def into(self) -> Array:
        """Matrix (3, 3) from these coordinates to the sensor's."""
        return np.asarray(np.linalg.inv(self.axes))


@dataclass(frozen=True)
class GroundPlane:
    """A plane of ground.

    Attributes
    ----------
    height
        Above the origin, m.
    gradient
        By how much it rises to the east and to the north (2,), tangents.
    """

    height: float
    gradient: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def through(cls, point: ArrayLike, gradient: ArrayLike) -> GroundPlane:
        """Return the plane of a gradient (2,) through a point (3,), ENU, m."""
        east, north, up = (float(x) for x in np.asarray(point, np.float64))
        rise_east, rise_north = (float(g) for g in np.asarray(gradient, np.float64))
        return cls(up - rise_east * east - rise_north * north, (rise_east, rise_north))

    @property
    def level(self) -> bool:
        """Whether it does not slope."""
        return self.gradient == (0.0, 0.0)

    def heights(self, xy: Array) -> Array:
        """Return its heights (n,) at points (n, 2), m."""
        return np.asarray(self.height + xy @ np.array(self.gradient))

    def levelled(self, vectors: Array) -> Array:
        """Return vectors (..., 3), ENU, less what the plane rises along them."""
        out = np.array(vectors, np.float64)
        out[..., 2] -= out[..., :2] @ np.array(self.gradient)
        return out

    def direction(self, vector: Array) -> Array:
        """Return a direction (3,) in coordinates in which the plane is level, of unit length."""
        if self.level:
            return np.asarray(vector)
        out = self.levelled(vector)
        return np.asarray(out / np.linalg.norm(out))

    def points(self, points: Array) -> Array:
        """Return points (..., 3), their heights counted from the plane, m."""
        out = self.levelled(points)
        out[..., 2] -= self.height
        return out

    def seen_pixel(self, pixel: Array, away: Array, levelled: Array) -> Array:
        """Return sizes of pixels (...), m, by which level ground shows as much as this plane does.

        Of two patches of ground alike, that shows more which is seen more steeply and nearer by;
        what is known of level ground is told the steepness in levelled coordinates.

        Parameters
        ----------
        pixel
            Across the lines of sight (...), m.
        away, levelled
            Ways to the camera (..., 3), as they are and levelled, m.
        """
        longer = np.linalg.norm(away, axis=-1) / np.linalg.norm(levelled, axis=-1)
        return np.asarray(pixel * np.sqrt(longer))

    def view(self, view: View) -> View:
        """Return a view in coordinates in which the plane is level, at height 0."""
        position = self.points(view.position)
        if self.level:
            return replace(view, position=position)
        return LevelledView(
            position, self.levelled(view.axes.T).T,
            view.fx, view.fy, view.cx, view.cy, view.width, view.height,
        )  # fmt: skip


LEVEL = GroundPlane(0.0)
