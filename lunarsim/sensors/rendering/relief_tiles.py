"""Tiles of the relief, and their selection and level of detail for a view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.sensors.rendering import _tile_kernels as kernels
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.world.terrain import Heightfield

SIDE = 32
BLOCKS = 4  # along each side of a tile
LEVELS = 6


@dataclass(frozen=True)
class TileChoice:
    """Tiles of a relief to draw for a view.

    Attributes
    ----------
    shown
        Whether each tile may be visible (n,).
    level, shadow_level
        Coarsest sufficient level of detail of every tile (n,), for the image and for the shadow
        map.
    nearest
        Minimum distance of a visible tile, m.
    low, high
        Corners of the bounding box of all visible tiles (3,), m.
    """

    shown: BoolArray
    level: IntArray
    shadow_level: IntArray
    nearest: float
    low: Array
    high: Array


@dataclass(frozen=True)
class ReliefTiles:
    """Division of a relief into tiles of 32 x 32 cells with several levels of detail.

    Attributes
    ----------
    first
        First column and row of each tile (n, 2).
    low, high
        Corners of the bounding box of each tile (n, 3), m; tiles without data are omitted.
    steepness
        Maximum gradient of each tile (n,).
    error
        Maximum vertical error of each level of detail (6, n), m: level l keeps every 2^l-th point.
    neighbour
        Indices of the tiles to the west, east, south and north of each (n, 4); its own index where
        there is none.
    """

    first: NDArray[np.int32]
    low: Array
    high: Array
    steepness: Array
    error: Array
    neighbour: IntArray

    @classmethod
    def of(cls, relief: Heightfield) -> ReliefTiles:
        """Divide a relief into tiles, and compute their bounds and errors."""
        g = relief.grid
        low, top, steep, error = kernels.tile_tables(relief.z, SIDE, LEVELS, g.posting)
        i, j = np.nonzero(np.isfinite(low))
        x0 = g.x0 + g.posting * SIDE * j
        y0 = g.y0 + g.posting * SIDE * i
        x1 = g.x0 + g.posting * np.minimum(SIDE * (j + 1), g.cols - 1)
        y1 = g.y0 + g.posting * np.minimum(SIDE * (i + 1), g.rows - 1)
        return cls(
            (SIDE * np.column_stack((j, i))).astype(np.int32),
            np.column_stack((x0, y0, low[i, j])),
            np.column_stack((x1, y1, top[i, j])),
            steep[i, j],
            error[:, i, j],
            _neighbours(i, j, low.shape),
        )

    def corners(self) -> Array:
        """Return the corners of every bounding box (n, 8, 3), m."""
        pick = (np.arange(8)[:, None] >> np.arange(3)) & 1
        return np.asarray(np.where(pick, self.high[:, None, :], self.low[:, None, :]))

    def choose(
        self, viewpoint: Array, axes: Array, bounds: Array, near: float, tolerance: float,
        shadow_tolerance: float,
    ) -> TileChoice:  # fmt: skip
        """Select the visible tiles and their levels of detail for a camera.

        Parameters
        ----------
        viewpoint, axes
            Position (3,), m, and axes (3, 3) of the camera, ENU.
        bounds
            Tangents at the left, right, upper and lower border of the image (4,).
        near
            Minimum depth, m.
        tolerance, shadow_tolerance
            Maximum vertical error per metre of distance, in the image and in the shadow map.
        """
        return TileChoice(*kernels.choose_tiles(
            self.low, self.high, self.error, viewpoint, np.ascontiguousarray(axes), bounds, near,
            tolerance, shadow_tolerance,
        ))  # fmt: skip


def _neighbours(i: IntArray, j: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Return the indices (n, 4) of the four neighbours of tiles.

    Tile k is at row `i[k]` and column `j[k]`; `shape` are the numbers of rows and columns of tiles.
    """
    number = np.full((shape[0] + 2, shape[1] + 2), -1)
    number[i + 1, j + 1] = np.arange(i.size)
    around = np.stack(
        [number[i + 1, j], number[i + 1, j + 2], number[i, j + 1], number[i + 2, j + 1]], axis=1
    )
    return np.where(around < 0, np.arange(i.size)[:, None], around)


def level_mesh(level: int) -> tuple[NDArray[np.int32], NDArray[np.uint32]]:
    """Return vertices (n, 2) and triangles (m, 3) of a tile at a level of detail.

    A vertex is the column and row of a grid point of the tile; a triangle has three vertex indices.
    At the finest level (0) the triangles are ordered by block.
    """
    step = 2**level
    n = SIDE // step
    jj, ii = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
    a = np.arange(n)[:, None] * (n + 1) + np.arange(n)
    if level == 0:
        wide = n // BLOCKS
        a = a.reshape(BLOCKS, wide, BLOCKS, wide).swapaxes(1, 2)
    a = a.reshape(BLOCKS * BLOCKS if level == 0 else 1, -1)
    # The diagonal runs from south-west to north-east, as in `Heightfield`.
    pair = np.stack(
        (np.stack((a, a + 1, a + n + 2), -1), np.stack((a, a + n + 2, a + n + 1), -1)), axis=1
    )
    triangles = pair.reshape(-1, 3)
    posts = step * np.column_stack((jj.ravel(), ii.ravel()))
    return posts.astype(np.int32), triangles.astype(np.uint32)
