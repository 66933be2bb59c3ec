"""LiDAR scan averaged over the squares of a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.grid import Grid
from lunarsim.onboard.navigation import _registration_kernels as k
from lunarsim.typing import Array, IntArray


@dataclass(frozen=True)
class ScanSurface:
    """LiDAR scan averaged over the squares of a grid, at the square centres.

    Attributes
    ----------
    col, row
        Grid indices of the squares (n,); they can lie outside the grid.
    position
        Square centres at the height of the scan (n, 3), ENU, m.
    normal
        (-dz/dx, -dz/dy, 1) of the scan (n, 3). Slopes of the map are not used: the noise of the map
        would look like slope, and flat terrain would seem to give position information.
    """

    col: IntArray
    row: IntArray
    position: Array
    normal: Array

    def __len__(self) -> int:
        return len(self.col)


def average_scan(points: Array, grid: Grid, min_points: int = 4) -> ScanSurface:
    """Average scan points (n, 3), m, over the squares of a grid; NaN is missing.

    `min_points` is the minimum number of points in a square. The averages are extrapolated to the
    square centres along the slopes; squares without four neighbours or with uneven points are
    omitted.
    """
    col, row, mean, _ = k.average_points(
        np.ascontiguousarray(points), grid.x0, grid.y0, grid.posting, min_points
    )
    height, slope, good = k.centre_heights(
        col, row, mean, grid.x0, grid.y0, grid.posting, 0.25 * grid.posting
    )
    col, row, height, slope = col[good], row[good], height[good], slope[good]
    position = np.stack(
        (grid.x0 + grid.posting * col, grid.y0 + grid.posting * row, height), axis=-1
    )
    return ScanSurface(col, row, position, np.column_stack((-slope, np.ones(len(col)))))
