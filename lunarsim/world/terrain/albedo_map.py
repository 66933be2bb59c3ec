"""Relative albedo of the terrain, on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from lunarsim.grid import Grid
from lunarsim.typing import Array


@dataclass(frozen=True)
class AlbedoMap:
    """Albedo of the terrain over its mean, on a grid.

    Attributes
    ----------
    grid
        Grid of the values.
    values
        Albedo over its mean (rows, cols), float32, row 0 south; 1 where the image has no data.
    """

    grid: Grid
    values: NDArray[np.float32]

    def at(self, xy: ArrayLike) -> Array:
        """Return bilinear values (...,) at points (..., 2), east and north, m."""
        xy, g = np.asarray(xy, dtype=np.float64), self.grid
        at = [(xy[..., 1] - g.y0) / g.posting, (xy[..., 0] - g.x0) / g.posting]
        return np.asarray(map_coordinates(self.values, at, np.float64, order=1, mode="nearest"))
