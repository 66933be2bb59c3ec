"""Classify true terrain by the two quantities on which mapper errors depend.

The class of a site depends on its hazard size (the larger of slope and roughness over their limits;
sites with 1 or more are unsafe), and on the horizontal distance to the nearest site of the other
safety class (the edge).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import SafetyMap
from lunarsim.typing import Array, BoolArray, IntArray

# Class boundaries of hazard size, and of distance to the edge, m (negative on unsafe terrain).
SIZES = np.array([0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0])
DISTANCES = np.array([-1.5, -0.9, -0.5, -0.25, 0.0, 0.25, 0.5, 0.9, 1.5, 2.5])
COUNT = (len(SIZES) + 1) * (len(DISTANCES) + 1)
# Class of cells without known truth.
UNKNOWN = 255


@dataclass(frozen=True)
class TruthLayers:
    """Hazard class, true safety and elevation of each cell of a simulated terrain.

    Attributes
    ----------
    grid
        Grid of the cells, true frame.
    kind
        Class of each cell (rows, cols); `UNKNOWN` where the true safety is not defined.
    safe
        True safety (rows, cols).
    elevation
        Elevation (rows, cols), m.
    """

    grid: Grid
    kind: NDArray[np.uint8]
    safe: BoolArray
    elevation: NDArray[np.float32]

    @classmethod
    def of(cls, safety: SafetyMap, elevation: NDArray[np.float32], lander: Lander) -> TruthLayers:
        """Compute classes from the safety and the elevation (rows, cols), m, of a raster."""
        size = hazard_size(safety.slope, safety.roughness, lander)
        to_unsafe = ndimage.distance_transform_edt(safety.safe)
        to_safe = ndimage.distance_transform_edt(~safety.safe)
        # The edge is halfway between cell centres, so half a cell is subtracted.
        distance = np.where(safety.safe, to_unsafe - 0.5, 0.5 - to_safe) * safety.grid.posting
        kind = hazard_class(size, distance)
        kind[~safety.observed] = UNKNOWN
        return cls(safety.grid, kind, safety.safe, elevation)

    def at(self, xy: ArrayLike) -> tuple[NDArray[np.uint8], BoolArray]:
        """Return hazard class and safety (...,) of the cells nearest to points (..., 2).

        The points are in the true frame, m. Points off the map are `UNKNOWN` and not safe.
        """
        grid = self.grid
        row, col = grid.cell(xy)
        inside = grid.contains(xy)
        row, col = np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)
        kind = np.where(inside, self.kind[row, col], np.uint8(UNKNOWN))
        return kind, np.asarray(inside & self.safe[row, col])

    def height(self, xy: ArrayLike) -> Array:
        """Return elevations of the cells nearest to points (..., 2), m; NaN off the map."""
        row, col = self.grid.cell(xy)
        inside = self.grid.contains(xy)
        row, col = np.clip(row, 0, self.grid.rows - 1), np.clip(col, 0, self.grid.cols - 1)
        return np.where(inside, self.elevation[row, col].astype(np.float64), np.nan)


def hazard_size(
    slope: NDArray[np.float32], roughness: NDArray[np.float32], lander: Lander
) -> Array:
    """Return the larger of slope and roughness, each over its limit (rows, cols).

    The limits are those of the lander.
    """
    return np.maximum(
        slope.astype(np.float64) / lander.slope_limit,
        roughness.astype(np.float64) / lander.roughness_limit,
    )


def hazard_class(size: ArrayLike, distance: ArrayLike) -> NDArray[np.uint8]:
    """Return the class index of sites from hazard size and distance to the edge.

    `size` is from `hazard_size`. `distance` is that to the border between safe and unsafe terrain,
    m, negative on unsafe terrain.
    """
    by_size = np.searchsorted(SIZES, size, side="right")
    by_distance = np.searchsorted(DISTANCES, distance, side="right")
    return np.asarray(by_size * (len(DISTANCES) + 1) + by_distance, dtype=np.uint8)


def size_class(kind: NDArray[np.uint8]) -> IntArray:
    """Return the hazard-size interval (index from 0) to which each class belongs."""
    return np.asarray(kind, dtype=np.int64) // (len(DISTANCES) + 1)
