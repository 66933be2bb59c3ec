"""Ground that is linear between the posts of a raster, by SciPy."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator


class RasterGround:
    """Heights (rows, cols) whose first post and posting are `frame` (3,)."""

    def __init__(self, z, frame):
        north = frame[1] + frame[2] * np.arange(z.shape[0])
        east = frame[0] + frame[2] * np.arange(z.shape[1])
        self._of = RegularGridInterpolator((north, east), z.astype(float), bounds_error=False)

    def elevation(self, xy):
        """Return the elevation (...,) at points (..., 2); NaN beyond the posts."""
        return self._of(np.asarray(xy, dtype=float)[..., ::-1])
