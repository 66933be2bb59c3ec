"""Selection of the parts of a relief that are turned away from the Sun.

Only these are drawn into a shadow map, and they are a small part of most terrain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.sensors.rendering import _tile_kernels as kernels
from lunarsim.sensors.rendering.relief_tiles import BLOCKS, SIDE, ReliefTiles
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.world.terrain import Heightfield

# Tolerance on the slope of the Sun's rays for faces turned away from the Sun, because a driver
# rounds corners to a fraction of a texel; and the texel size, in postings, up to which it suffices.
_SLOPE_TOLERANCE = 0.05
_MAX_TEXEL_POSTINGS = 3.0


class ShadowCasterBlocks:
    """Blocks of 8 x 8 cells that have a face turned away from the Sun.

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
