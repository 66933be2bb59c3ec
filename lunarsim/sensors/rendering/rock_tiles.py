"""Spatial index of rocks, so that rendering examines only those near the view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.pinhole import View
from lunarsim.sensors.rendering import _cull_kernels as cull
from lunarsim.sensors.rendering import _rock_tile_kernels as kernels
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.sensors.rendering.shadow_map_reads import ShadowMapReads
from lunarsim.typing import Array, IntArray

# Mean number of rocks per tile: examining a tile takes as long as examining one or two rocks.
_ROCKS_PER_TILE = 24
_MAX_TILES_PER_SIDE = 512


@dataclass(frozen=True)
class DrawnRocks:
    """Rocks in an image or a shadow map, in order of their indices.

    Attributes
    ----------
    box
        Box of pixels or texels that covers each rock (m, 4), float32: minimum column, minimum row,
        maximum column, maximum row; pixel centres have integer coordinates, from 0.
    rock_indices
        Indices of the rocks (m,).
    """

    box: NDArray[np.float32]
    rock_indices: NDArray[np.int32]


@dataclass(frozen=True)
class RockTiles:
    """Rocks sorted into square tiles, with the bounds of the rocks in each tile.

    Attributes
    ----------
    rocks, reach, foot
        Rows of `RockField.rows` (n, 9), outline radius (n,), m, and the elevation down to which the
        rock's sides are drawn (n,), m.
    order, start
        Tile t contains the rocks `order[start[t]:start[t + 1]]`; empty tiles are omitted.
    low, high
        Corners of the bounding box (t, 3) of the rocks' positions and elevations, m.
    radius, margin
        Radius of the largest sphere around a rock's base that contains the rock, and maximum
        lateral extent of a rock from its position, for each tile (t,), m.
    """

    rocks: Array
    reach: Array
    foot: Array
    order: IntArray
    start: IntArray
    low: Array
    high: Array
    radius: Array
    margin: Array

    @classmethod
    def of(cls, rocks: Array, reach: Array, foot: Array) -> RockTiles:
        """Sort rocks (n, 9) into square tiles, and compute the bounds of each tile.

        `reach` (n,) are outline radii, and `foot` (n,) elevations down to which sides are drawn, m.
        """
        count = len(rocks)
        side = int(np.clip(np.sqrt(count / _ROCKS_PER_TILE), 1, _MAX_TILES_PER_SIDE))
        place = rocks[:, :2]
        first = place.min(axis=0, initial=np.inf)
        extent = np.maximum(place.max(axis=0, initial=-np.inf) - first, 1e-9)
        column, row = np.minimum((side * ((place - first) / extent)).astype(int), side - 1).T
        tile = side * row + column
        order = np.argsort(tile, kind="stable")
        start = np.append(np.flatnonzero(np.diff(tile[order], prepend=-1)), count)
        bounds = kernels.tile_bounds(rocks, reach, foot, order, start)
        return cls(rocks, reach, foot, order, start, *bounds)

    def visible(self, view: View, near: float) -> DrawnRocks:
        """Return the rocks that may cover pixels of a view, with their boxes of pixels.

        `near` is the minimum depth, m.
        """
        towards = np.ascontiguousarray(view.axes.T)
        size = (float(view.width), float(view.height))
        lens = (view.fx, view.fy, view.cx, view.cy, *size, near)
        kept = kernels.tiles_in_view(
            self.low, self.high, self.radius, view.position, towards, *lens
        )
        rock_indices = kernels.rocks_in_tiles(self.order, self.start, kept)
        box, seen = cull.visible_rocks(
            self.rocks, self.reach, self.foot, rock_indices, view.position, towards, *lens
        )
        return DrawnRocks(*cull.select_boxes(box, rock_indices, seen))

    def shadow_casters(self, view: View, frame: ShadowFrame, reads: ShadowMapReads) -> DrawnRocks:
        """Return the rocks that may shadow texels of a shadow map that an image reads."""
        size = (float(frame.size[0]), float(frame.size[1]))
        map_ = (frame.lean, frame.axes, frame.corner, frame.texel, *size)
        kept = kernels.tiles_that_shade(self.low, self.high, self.margin, view.position, *map_)
        rock_indices = kernels.rocks_in_tiles(self.order, self.start, kept)
        box, seen = cull.shadow_casting_rocks(
            self.rocks, self.reach, self.foot, rock_indices, view.position, *map_,
            reads.normal, reads.lower_bound, reads.upper_bound,
        )  # fmt: skip
        return DrawnRocks(*cull.select_boxes(box, rock_indices, seen))
