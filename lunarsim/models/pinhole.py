"""Pinhole projection: viewing rays, and image coordinates of points.

Sensor coordinates are x right, y down, z along the boresight; the centre of the first pixel is
(0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsim.errors import InputError
from lunarsim.typing import Array

_IDENTITY = np.eye(3)


class Pinhole(NamedTuple):
    """Pinhole projection defined by focal lengths and principal point, pixels."""

    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def matrix(self) -> Array:
        """Intrinsic matrix (3, 3), as in OpenCV."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: Array) -> Array:
        """Project points (n, 3) in sensor coordinates, m, to pixels (n, 2).

        The result is meaningless for z < 0 and not finite for z = 0.

        Examples
        --------
        >>> camera = Pinhole(500.0, 500.0, 319.5, 239.5)
        >>> camera.project(np.array([[0.0, 0.0, 10.0], [1.0, 0.0, 10.0]]))
        array([[319.5, 239.5],
               [369.5, 239.5]])
        """
        x, y, z = points.T
        return np.column_stack((x / z * self.fx + self.cx, y / z * self.fy + self.cy))

    def jacobian(self, points: Array, axes: Array = _IDENTITY) -> Array:
        """Differentiate the pixels of points (n, 3) with respect to k variables.

        `axes` (3, k) holds the derivatives of a point's sensor coordinates with respect to k
        variables; if omitted, the variables are the sensor coordinates. Returns (n, 2, k).
        """
        x, y, z = points.T
        a, b, c = axes[:, :, None]
        out = np.empty((len(points), 2, len(axes.T)))
        out[:, 0] = (self.fx * (a - x / z * c) / z).T
        out[:, 1] = (self.fy * (b - y / z * c) / z).T
        return out

    def tangents(self, width: int, height: int) -> tuple[Array, Array]:
        """Return the tangents of each pixel's line of sight, right and down.

        `width` and `height` are the size of the image; both results are (height, width).
        """
        u = (np.arange(width) - self.cx) / self.fx
        v = (np.arange(height) - self.cy) / self.fy
        right, down = np.meshgrid(u, v)
        return right, down


@dataclass(frozen=True)
class View:
    """Pose, projection and image size of a pinhole camera.

    Attributes
    ----------
    position
        Position of the camera, ENU (3,), m.
    axes
        Rotation (3, 3), sensor to ENU.
    fx, fy, cx, cy
        Focal lengths and principal point, pixels; the centre of the first pixel is (0, 0).
    width, height
        Size of the image, pixels.
    """

    position: Array
    axes: Array
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @property
    def enu_to_sensor(self) -> Array:
        """Rotation (3, 3) from ENU to the sensor frame."""
        return self.axes.T

    @property
    def pinhole(self) -> Pinhole:
        """Projection of the camera."""
        return Pinhole(self.fx, self.fy, self.cx, self.cy)

    @property
    def border_tangents(self) -> tuple[float, float, float, float]:
        """Line-of-sight tangents at the left, right, upper and lower image border."""
        return (
            (-0.5 - self.cx) / self.fx,
            (self.width - 0.5 - self.cx) / self.fx,
            (-0.5 - self.cy) / self.fy,
            (self.height - 0.5 - self.cy) / self.fy,
        )

    def rays(self) -> Array:
        """Return the line of sight of every pixel as unit vectors (height, width, 3), ENU."""
        uu, vv = self.pinhole.tangents(self.width, self.height)
        rays = np.stack((uu, vv, np.ones_like(uu)), axis=-1) @ self.axes.T
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def check_finite_position(position: Array) -> None:
    """Raise InputError if a coordinate of a camera's position is not finite."""
    for i, coordinate in enumerate(position):
        if not np.isfinite(coordinate):
            raise InputError(f"camera.position[{i}]", float(coordinate), "must be finite")
