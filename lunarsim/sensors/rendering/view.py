"""What is asked of the renderer, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """Where a pin-hole camera is and what it covers.

    Attributes
    ----------
    position
        ENU (3,), m.
    axes
        Rotation (3, 3), sensor (x right, y down, z along the boresight) to ENU.
    fx, fy, cx, cy
        Focal lengths and principal point, pixels; the centre of the first pixel is (0, 0).
    width, height
        Pixels.
    """

    position: Array
    axes: Array
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def rays(self) -> Array:
        """Return the unit vectors of all pixels (height, width, 3), ENU."""
        u = (np.arange(self.width) - self.cx) / self.fx
        v = (np.arange(self.height) - self.cy) / self.fy
        uu, vv = np.meshgrid(u, v)
        rays = np.stack((uu, vv, np.ones_like(uu)), axis=-1) @ self.axes.T
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


@dataclass(frozen=True)
class Image:
    """What a view shows.

    Attributes
    ----------
    radiance
        Radiance factor I/F (height, width), float32; 0 for the sky.
    range
        Distance along the pixel's ray (height, width), m, NaN for the sky; None unless asked.
    normal
        Unit surface normal (height, width, 3), ENU, NaN for the sky; None unless asked.
    identity
        Rock number (height, width), -1 for relief, -2 for the sky; None unless asked.
    """

    radiance: NDArray[np.float32]
    range: NDArray[np.float32] | None = None
    normal: NDArray[np.float32] | None = None
    identity: NDArray[np.int32] | None = None
