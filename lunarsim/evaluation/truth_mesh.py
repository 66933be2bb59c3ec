"""Reference truth of the quadtree paper: deviations from a coarse mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.typing import Array


class TruthMesh:
    """Coarse triangular mesh of the true terrain; deviations from it are hazards.

    The nodes of the mesh are the mean elevations of squares of terrain.

    Parameters
    ----------
    elevation
        True elevation at full resolution (rows, cols), m.
    grid
        Grid of the elevation.
    spacing
        Side of the squares, m: 2 lambda_z in the quadtree paper. It is rounded to a multiple of the
        grid spacing.
    """

    def __init__(self, elevation: ArrayLike, grid: Grid, spacing: float) -> None:
        z = np.asarray(elevation, dtype=np.float64)
        n = round(spacing / grid.posting)
        rows, cols = grid.rows // n, grid.cols // n
        if n < 1 or rows < 2 or cols < 2:
            raise InputError(
                "truth.spacing",
                spacing,
                f"must be between the posting of the map ({grid.posting} m) and half its side",
            )
        self.spacing = n * grid.posting
        self.z = z[: rows * n, : cols * n].reshape(rows, n, cols, n).mean(axis=(1, 3))
        self.x0 = grid.x0 + 0.5 * (n - 1) * grid.posting
        self.y0 = grid.y0 + 0.5 * (n - 1) * grid.posting

    def plane(self, xy: ArrayLike) -> tuple[Array, Array]:
        """Return unit normals (..., 3) and heights (...), m, of the mesh at points.

        `xy` (..., 2) are the points, east and north, m.

        Points outside the outermost nodes give NaN. The diagonal between four nodes runs from
        south-west to north-east.
        """
        xy = np.asarray(xy, dtype=np.float64)
        u = (xy[..., 0] - self.x0) / self.spacing
        v = (xy[..., 1] - self.y0) / self.spacing
        rows, cols = self.z.shape
        inside = (u >= 0) & (u <= cols - 1) & (v >= 0) & (v <= rows - 1)
        col = np.clip(np.floor(u), 0, cols - 2).astype(np.int64)
        row = np.clip(np.floor(v), 0, rows - 2).astype(np.int64)
        u, v = u - col, v - row
        a, b = self.z[row, col], self.z[row, col + 1]
        c, d = self.z[row + 1, col], self.z[row + 1, col + 1]
        lower = u >= v
        east = np.where(lower, b - a, d - c)
        north = np.where(lower, d - b, c - a)
        height = np.where(inside, a + u * east + v * north, np.nan)
        slope = np.stack((-east / self.spacing, -north / self.spacing, np.ones_like(east)), axis=-1)
        normal = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
        return np.where(inside[..., None], normal, np.nan), height

    def distance(self, elevation: ArrayLike, grid: Grid) -> Array:
        """Return the signed orthogonal distance of terrain to the mesh (rows, cols), m.

        `elevation` (rows, cols) is the terrain on `grid`.
        """
        normal, height = self.plane(grid.centres())
        return np.asarray((np.asarray(elevation, dtype=np.float64) - height) * normal[..., 2])

    def hazards(self, elevation: ArrayLike, grid: Grid, limit: float) -> Array:
        """Return 1 where terrain deviates from the mesh by over `limit` (m), else 0.

        NaN where there is no mesh (rows, cols).
        """
        d = self.distance(elevation, grid)
        return np.where(np.isnan(d), np.nan, (np.abs(d) > limit).astype(np.float64))
