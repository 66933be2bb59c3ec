"""A scan averaged over squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.navigation import _registration_kernels as k

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Surface:
    """A scan averaged over the squares of a grid, at their middles.

    Attributes
    ----------
    col, row
        Of the squares (m,); may lie beyond the grid.
    position
        Middles of the squares at the scan's height there (m, 3), ENU, m.
    normal
        (-dz/dx, -dz/dy, 1) of the scan (m, 3). It comes from the scan, not from the map, whose
        noise would look like slope and make flat ground seem to tell where it is.
    """

    col: IntArray
    row: IntArray
    position: Array
    normal: Array

    def __len__(self) -> int:
        return len(self.col)


def surface_of(points: Array, grid: Grid, least: int = 4) -> Surface:
    """Average points (n, 3), NaN for none, over the squares of a grid."""
    col, row, mean, _ = k.average(
        np.ascontiguousarray(points), grid.x0, grid.y0, grid.posting, least
    )
    height, slope, good = k.surface(
        col, row, mean, grid.x0, grid.y0, grid.posting, 0.25 * grid.posting
    )
    col, row, height, slope = col[good], row[good], height[good], slope[good]
    position = np.stack(
        (grid.x0 + grid.posting * col, grid.y0 + grid.posting * row, height), axis=-1
    )
    return Surface(col, row, position, np.column_stack((-slope, np.ones(len(col)))))
