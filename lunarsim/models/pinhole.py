"""Where a pin-hole looks from, and along which rays."""

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
