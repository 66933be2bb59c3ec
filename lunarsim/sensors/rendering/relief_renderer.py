"""Drawing of the relief: tiles at the level of detail that an image needs."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunarsim.sensors.rendering import _tile_kernels as kernels
from lunarsim.sensors.rendering.programs import CORNERS, float_texture, tile_mesh
from lunarsim.sensors.rendering.relief_tiles import (
    BLOCKS,
    LEVELS,
    SIDE,
    ReliefTiles,
    ShadowCasterBlocks,
)
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.world.terrain import Heightfield

# Instance attributes of a tile in relief_vertex.glsl.
_INSTANCE = np.dtype([("tile", "4i4"), ("edges", "4i4"), ("placed", "16f4")])


class ReliefRenderer:
    """Renderer of the depth map and the shadow map of a relief.

    Parameters
    ----------
    ctx
        OpenGL context.
    programs
        Programs of the context.
    relief
        Relief to draw.

    Attributes
    ----------
    tiles
        Tiles of the relief.
    corners
        Texture of the elevations of the corners of each cell.
    datum
        Elevation that is zero in the texture, m.
    """

    def __init__(
        self, ctx: moderngl.Context, programs: dict[str, moderngl.Program], relief: Heightfield
    ) -> None:
        self.tiles = ReliefTiles.of(relief)
        self._lee = ShadowCasterBlocks(relief, self.tiles)
        self._grid = relief.grid
        # Elevations are relative to the middle, rounded to metres, for the precision of float32.
        finite = relief.z[np.isfinite(relief.z)]
        self.datum = float(np.round(0.5 * (finite.min() + finite.max()))) if finite.size else 0.0
        self.corners = float_texture(ctx, kernels.cell_corners(relief.z, self.datum))
        self._programs = programs
        self._ctx = ctx
        self._buffer = ctx.buffer(reserve=_INSTANCE.itemsize)
        self._vaos: dict[tuple[str, int], moderngl.VertexArray] = {}

    def draw(self, matrix: Array, viewpoint: Array, shown: BoolArray, level: IntArray) -> None:
        """Draw the depth of the selected tiles of the relief.

        Parameters
        ----------
        matrix
            Transform from metres relative to the camera, ENU, to clip coordinates (4, 4).
        viewpoint
            Position of the camera, ENU (3,), m.
        shown, level
            Tiles to draw, and the level of detail of every tile (n,).
        """
        self.corners.use(CORNERS)
        for k in range(LEVELS):
            picked = np.flatnonzero(shown & (level == k))
            if picked.size:
                self._draw_instances("relief", k, self._instances(matrix, viewpoint, picked, level))

    def draw_shadows(
        self, frame: ShadowFrame, sun: Array, viewpoint: Array, shades: BoolArray,
        level: IntArray,
    ) -> None:  # fmt: skip
        """Draw the parts of tiles that are turned away from the Sun into a shadow map.

        Parameters
        ----------
        frame
            Frame of the map.
        sun
            Unit vector to the Sun (3,), ENU.
        viewpoint
            Position of the camera, ENU (3,), m.
        shades, level
            Tiles to draw, and the level of detail of every tile (n,).
        """
        self.corners.use(CORNERS)
        matrix = frame.matrix()
        for k in range(LEVELS):
            picked = np.flatnonzero(shades & (level == k))
            if picked.size == 0:
                continue
            rows = self._instances(matrix, viewpoint, picked, level)
            if k > 0:
                self._draw_instances("relief-shadow", k, rows)
                continue
            lee = self._lee.of(picked, rows["edges"], sun, frame.texel)
            for block, some in enumerate(lee.T):
                if some.any():
                    self._draw_instances("relief-shadow", 0, rows[some], block)

    def _draw_instances(
        self, name: str, level: int, instances: NDArray[np.void], block: int | None = None
    ) -> None:
        """Draw a tile mesh once per row of instance attributes.

        `name` is the shader program and `level` the level of detail. `block` is the number of a
        block of the mesh to draw; None: the complete mesh.
        """
        if (name, level) not in self._vaos:
            posts, triangles = tile_mesh(self._ctx, level)
            instance = (self._buffer, "4i 4i 16f/i", "tile", "edges", "placed")
            self._vaos[name, level] = self._ctx.vertex_array(
                self._programs[name], [(posts, "2i", "post"), instance], triangles
            )
        self._buffer.orphan(instances.nbytes)
        self._buffer.write(instances.tobytes())
        if block is None:
            self._vaos[name, level].render(instances=len(instances))
        else:
            count = 6 * (SIDE // BLOCKS) ** 2
            self._vaos[name, level].render(
                vertices=count, first=count * block, instances=len(instances)
            )

    def _instances(
        self,
        matrix: Array,
        viewpoint: Array,
        tile_indices: IntArray,
        level: IntArray,
    ) -> NDArray[np.void]:
        """Return the OpenGL instance attributes of the tiles with indices `tile_indices`.

        `matrix` (4, 4) transforms metres relative to the camera to clip coordinates; `level` (n,)
        are the levels of detail of all tiles. Positions are computed in float64.
        """
        g, tiles = self._grid, self.tiles
        rows = np.empty(tile_indices.size, _INSTANCE)
        first = tiles.first[tile_indices]
        rows["tile"][:, :2] = first
        rows["tile"][:, 2:] = np.array([g.cols, g.rows]) - 1 - first
        rows["edges"] = np.maximum(level[tiles.neighbour[tile_indices]], level[tile_indices, None])
        corner = np.empty((tile_indices.size, 4))
        corner[:, :2] = first * g.posting + np.array([g.x0, g.y0]) - viewpoint[:2]
        corner[:, 2] = self.datum - viewpoint[2]
        corner[:, 3] = 1.0
        placed = rows["placed"].reshape(-1, 4, 4)  # column by column
        placed[:, 0] = matrix[:, 0] * g.posting
        placed[:, 1] = matrix[:, 1] * g.posting
        placed[:, 2] = matrix[:, 2]
        placed[:, 3] = corner @ matrix.T
        return rows
