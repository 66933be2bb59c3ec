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
# Tolerance on the slope of the Sun's rays for faces turned away from the Sun, because a driver
# rounds corners to a fraction of a texel; and the texel size, in postings, up to which it suffices.
_SLOPE_TOLERANCE = 0.05
_MAX_TEXEL_POSTINGS = 3.0


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


class ShadowCasterBlocks:
    """Blocks of 8 x 8 cells that have a face turned away from the Sun.

    Only these are drawn into a shadow map, and they are a small part of most terrain.

    Parameters
    ----------
    relief
        Relief.
    tiles
        Tiles of the relief, which consist of the blocks.
    """

    def __init__(self, relief: Heightfield, tiles: ReliefTiles) -> None:
        self._relief = relief
        self._first = tiles.first
        self._sun = np.zeros(3)
        self._known = np.zeros(len(tiles.first), np.bool_)
        self._lee = np.zeros((len(tiles.first), BLOCKS * BLOCKS), np.bool_)

    def of(
        self, tile_indices: IntArray, edges: NDArray[np.int32], sun: Array, texel: float
    ) -> BoolArray:
        """Return which blocks (m, 16) of each tile must be drawn into a shadow map.

        These have a face turned away from the Sun. If texels are coarse, all blocks are drawn. The
        tiles are drawn at their finest level of detail.

        Parameters
        ----------
        tile_indices
            Indices of the tiles (m,).
        edges
            Levels of detail of the neighbours' edges (m, 4); all blocks of a tile with a coarser
            neighbour are drawn.
        sun
            Unit vector to the Sun (3,), ENU.
        texel
            Texel size of the shadow map, m.
        """
        p = self._relief.grid.posting
        if texel > _MAX_TEXEL_POSTINGS * p:
            return np.ones((len(tile_indices), BLOCKS * BLOCKS), np.bool_)
        if not np.array_equal(sun, self._sun):
            self._sun = np.array(sun)
            self._known[:] = False
        new = tile_indices[~self._known[tile_indices]]
        self._lee[new] = kernels.shadow_caster_blocks(
            self._relief.z, self._first[new], SIDE, BLOCKS, p, self._sun, 1.0 - _SLOPE_TOLERANCE
        )
        self._known[new] = True
        lee = self._lee[tile_indices]
        lee[np.any(edges > 0, axis=1)] = True
        return lee
