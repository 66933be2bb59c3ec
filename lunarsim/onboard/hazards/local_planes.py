"""Least-squares planes through the points of a map, in squares of its cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.onboard.hazards import _plane_kernels as k
from lunarsim.typing import Array


@dataclass(frozen=True)
class LocalPlaneGrid:
    """Division of a map into squares in which the terrain is approximated by a plane.

    Attributes
    ----------
    grid
        Cells of the map.
    cells
        Side of a square in cells of the map.
    """

    grid: Grid
    cells: int

    @classmethod
    def of(cls, grid: Grid, edges: Array) -> LocalPlaneGrid:
        """Choose squares with a side of about two typical triangle edges.

        `grid` holds the cells of the map; `edges` (m,) are edge lengths of the triangles between
        elevation samples, m. The side is between 2 and 64 cells; without edges it is 8 cells.
        """
        if not len(edges):
            return cls(grid, 8)
        return cls(grid, int(np.clip(np.ceil(2.0 * np.median(edges) / grid.posting), 2, 64)))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of squares."""
        return -(-self.grid.rows // self.cells), -(-self.grid.cols // self.cells)

    def at(self, values: Array, points: Array) -> Array:
        """Look up the values of the squares that contain given points.

        `values` (square rows, square columns, ...) has one entry per square. `points` (n, 2 or
        more) start with east and north, m. The result has shape (n, ...); points off the map get
        the value of the nearest square at its edge.
        """
        row, col = self.grid.cell(points[:, :2])
        rows, cols = self.shape
        at = np.clip(row // self.cells, 0, rows - 1), np.clip(col // self.cells, 0, cols - 1)
        return np.ascontiguousarray(values[at])

    def fit_planes(self, vertices: Array) -> Array:
        """Fit a least-squares plane around each square, from elevation samples.

        `vertices` (n, 3) are the samples: east, north, up, m. The fit of a square uses the samples
        in the 5 x 5 squares centred on it. The result (square rows, square columns, 3) contains the
        height of the plane at the centre of the raster of squares, m, its slope to the east and its
        slope to the north. With fewer than six samples, or samples on one line, the plane is
        horizontal at their mean height; without samples it is 0.
        """
        west, _, south, _ = self.grid.extent
        sums = np.zeros((*self.shape, 9))
        k.plane_sums(vertices, west, south, self.cells * self.grid.posting, sums)
        s = 25.0 * ndimage.uniform_filter(sums, (5, 5, 1), mode="constant")
        n = np.maximum(s[..., 0], 1.0)
        xx = s[..., 4] - s[..., 1] ** 2 / n
        xy = s[..., 5] - s[..., 1] * s[..., 2] / n
        yy = s[..., 6] - s[..., 2] ** 2 / n
        xz = s[..., 7] - s[..., 1] * s[..., 3] / n
        yz = s[..., 8] - s[..., 2] * s[..., 3] / n
        determinant = xx * yy - xy * xy
        sound = (s[..., 0] > 5.5) & (determinant > 1e-9 * np.maximum(xx * yy, 1e-12))
        safe = np.where(sound, determinant, 1.0)
        east = np.where(sound, (yy * xz - xy * yz) / safe, 0.0)
        north = np.where(sound, (xx * yz - xy * xz) / safe, 0.0)
        level = (s[..., 3] - east * s[..., 1] - north * s[..., 2]) / n
        return np.stack((level, east, north), axis=-1)

    def plane_heights(self, planes: Array, points: Array) -> Array:
        """Return the heights of the fitted planes at points (n,), m.

        `planes` is the result of `fit_planes`; `points` (n, 2 or more) start with east and north,
        m.
        """
        west, _, south, _ = self.grid.extent
        side = self.cells * self.grid.posting
        rows, cols = self.shape
        x = points[:, 0] - west - 0.5 * side * cols
        y = points[:, 1] - south - 0.5 * side * rows
        own = self.at(planes, points)
        return np.asarray(own[:, 0] + own[:, 1] * x + own[:, 2] * y)
