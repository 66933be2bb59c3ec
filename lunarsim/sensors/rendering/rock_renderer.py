"""Drawing of rocks: screen boxes in which the shader intersects the exact shape.

Rocks of a few pixels are ray traced on the CPU and drawn as points.
"""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunarsim.models.pinhole import View
from lunarsim.rocks.shapes import CUBE, ELLIPSOID, shape_table
from lunarsim.sensors.rendering import _cull_kernels as kernels
from lunarsim.sensors.rendering import _small_rock_kernels as small_rocks
from lunarsim.sensors.rendering.programs import ROCK_KINDS, ROCKS, float_texture
from lunarsim.sensors.rendering.rock_tiles import DrawnRocks, RockTiles
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.sensors.rendering.shadow_map_reads import ShadowMapReads
from lunarsim.sensors.rendering.target import ShadowMap
from lunarsim.typing import Array
from lunarsim.world.terrain import Terrain

_TEXTURE = 1024
# Drawing a point takes as long as filling and transferring this many texels.
_TEXELS_PER_POINT = 100


class RockRenderer:
    """Renderer of the rocks of one terrain, in images and shadow maps.

    Parameters
    ----------
    ctx
        OpenGL context.
    programs
        Programs of the context.
    terrain
        Terrain with the rocks.
    """

    def __init__(
        self, ctx: moderngl.Context, programs: dict[str, moderngl.Program], terrain: Terrain
    ) -> None:
        rocks = terrain.rocks
        self._ctx = ctx
        self._programs = programs
        self._rows = rocks.rows()
        reach = rocks.reach()
        self._shapes = shape_table()
        g = terrain.relief.grid
        feet = kernels.rock_feet(self._rows, reach, terrain.relief.z, g.x0, g.y0, g.posting)
        self._tiles = RockTiles.of(self._rows, reach, feet)
        self._foot, self._top = feet, self._rows[:, 2] + self._rows[:, 5]
        place = self._rows[:, :2]
        corner = np.array([g.x0, g.y0])
        last = corner + g.posting * (np.array([g.cols, g.rows]) - 1)
        over = np.maximum(corner - place, place - last).max(axis=1) + 1.5 * reach > 0.0
        # Where no relief hides it, a rock's side extends downwards without limit.
        self._bottomless = over | (not np.isfinite(terrain.relief.z).all())
        self.tallest = float(self._rows[:, 5].max(initial=0.0))
        self.lowest = float(feet.min(initial=np.inf))
        shape = self._rows[:, 8].astype(int)
        named = {ELLIPSOID: "half-sphere", CUBE: "cube"}
        self._kind = np.array([ROCK_KINDS.index(named.get(s, "hull")) for s in shape], np.int8)
        count = len(rocks)
        lines = max(1, -(-count // _TEXTURE))
        texels = np.zeros((lines * _TEXTURE, 12), np.float32)
        texels[:count, :9] = self._rows
        self._texture = float_texture(ctx, texels.reshape(lines, 3 * _TEXTURE, 4))
        self._corners = ctx.buffer(reserve=48)
        self._order = ctx.buffer(reserve=4)  # too small for any box
        self._points = ctx.buffer(reserve=28)
        self._vaos: dict[moderngl.Program, moderngl.VertexArray] = {}
        self.count = count
        self._texels = texels
        self._albedo = np.ones(count)

    def set_albedo(self, albedo: Array) -> None:
        """Set the albedo of every rock (n,), relative to the mean of the terrain."""
        if not np.array_equal(albedo, self._albedo):
            self._albedo = albedo
            self._texels[: len(albedo), 9] = albedo
            lines = len(self._texels) // _TEXTURE
            self._texture = float_texture(self._ctx, self._texels.reshape(lines, 3 * _TEXTURE, 4))

    def visible_rocks(self, view: View, near: float) -> DrawnRocks:
        """Return the rocks that are visible in a view with minimum depth `near`, m."""
        return self._tiles.visible(view, near)

    def elevation_bounds(self, visible: DrawnRocks) -> tuple[float, float]:
        """Return the minimum and maximum elevation, m, of rocks in a view.

        The rocks `visible` are included from their feet, at which drawing stops, to their tops;
        without rocks the result is (inf, -inf). It is (-inf, inf) if the side of a visible rock
        continues downwards without limit: at the edge of the relief, or on a relief with missing
        elevations.
        """
        if self._bottomless[visible.rock_indices].any():
            return -np.inf, np.inf
        lowest = self._foot[visible.rock_indices].min(initial=np.inf)
        return float(lowest), float(self._top[visible.rock_indices].max(initial=-np.inf))

    def draw(
        self, programs: dict[str, moderngl.Program], view: View, near: float, visible: DrawnRocks,
        truth: bool,
    ) -> None:  # fmt: skip
        """Draw the visible rocks over an image of the relief.

        Parameters
        ----------
        programs
            Shading programs.
        view
            Camera view of the image.
        near
            Minimum depth, m.
        visible
            Rocks that are visible in the image.
        truth
            Whether range, normal and identity are also output.
        """
        towards = np.ascontiguousarray(view.axes.T)
        box, rock_indices = visible.box, visible.rock_indices
        small, start, rest = small_rocks.split_by_size(box)
        suffix = "-truth" if truth else ""
        self._draw_boxes(programs, suffix, box[rest], rock_indices[rest])
        points, hit = small_rocks.trace_view_rays(
            self._rows, self._shapes.planes, self._shapes.count, box, rock_indices, small, start,
            view.position, towards, view.fx, view.fy, view.cx, view.cy, near,
        )  # fmt: skip
        self._draw_points(programs["small-rocks" + suffix], points[hit])

    def draw_shadows(
        self, view: View, frame: ShadowFrame, reads: ShadowMapReads, shadow: ShadowMap
    ) -> None:
        """Clear a shadow map, and draw all rocks that shadow the texels to be read.

        `frame` is the geometry of the map, and `reads` the part that the image reads.
        """
        shading = self._tiles.shadow_casters(view, frame, reads)
        box, rock_indices = shading.box, shading.rock_indices
        small, start, rest = small_rocks.split_by_size(box)
        points, hit = small_rocks.trace_sun_rays(
            self._rows, self._shapes.planes, self._shapes.count, box, rock_indices, small, start,
            view.position, frame.lean, frame.axes, frame.corner, frame.texel, *frame.heights,
        )  # fmt: skip
        shadow.buffer.viewport = (0, 0, *frame.size)
        if len(points) * _TEXELS_PER_POINT > frame.size[0] * frame.size[1]:
            dark = small_rocks.min_depth(points, hit, frame.size[1], frame.size[0])
            shadow.texture.write(dark, viewport=(0, 0, *frame.size))
        else:
            # Clear the complete map: drivers clear a part far more slowly.
            shadow.buffer.clear(1.0)
            self._draw_points(self._programs["small-rocks-shadow"], points[hit])
        self._draw_boxes(self._programs, "-shadow", box[rest], rock_indices[rest])

    def _draw_boxes(
        self, programs: dict[str, moderngl.Program], suffix: str, box: NDArray[np.float32],
        rock_indices: NDArray[np.int32],
    ) -> None:  # fmt: skip
        kinds = self._kind[rock_indices]
        for k, kind in enumerate(ROCK_KINDS):
            picked = np.flatnonzero(kinds == k)
            if picked.size:
                corners = kernels.box_corners(box, rock_indices, picked)
                self._draw_corners(programs[kind + suffix], corners)

    def _draw_corners(self, program: moderngl.Program, corners: NDArray[np.float32]) -> None:
        self._texture.use(ROCKS)
        boxes = len(corners) // 4
        if 24 * boxes > self._order.size:
            count = max(boxes, min(2 * boxes, len(self._rows)))
            order = np.array([0, 1, 2, 2, 1, 3]) + 4 * np.arange(count)[:, None]
            self._order.orphan(24 * count)
            self._order.write(order.astype(np.int32).tobytes())
        self._corners.orphan(corners.nbytes)
        self._corners.write(corners)
        if program not in self._vaos:
            self._vaos[program] = self._ctx.vertex_array(
                program, [(self._corners, "2f 1f", "corner", "number")], self._order
            )
        self._vaos[program].render(moderngl.TRIANGLES, vertices=6 * boxes)

    def _draw_points(self, program: moderngl.Program, points: NDArray[np.float32]) -> None:
        """Draw pixels of small rocks as OpenGL points.

        `points` (n, 7 or 3) are column, row and depth, and in an image also normal and rock index.
        """
        if len(points) == 0:
            return
        self._texture.use(ROCKS)
        self._points.orphan(points.nbytes)
        self._points.write(points)
        if program not in self._vaos:
            parts = ("3f 4f", "at", "stone") if points.shape[1] == 7 else ("3f", "at")
            self._vaos[program] = self._ctx.vertex_array(program, [(self._points, *parts)])
        self._vaos[program].render(moderngl.POINTS, vertices=len(points))
