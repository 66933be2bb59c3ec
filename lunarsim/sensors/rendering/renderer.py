"""`Renderer`: pictures of one terrain.

The relief is drawn as tiles of triangles at a level of detail whose error stays below a fraction
of a pixel; its normals always come from the finest triangles. Rocks are boxes on the screen in
which the shader meets the exact shape. Shadows come from a map along the Sun's rays that holds the
highest face turned away from the Sun: a lit face never lies on it, so nothing shades itself.
"""

from __future__ import annotations

import weakref
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, RenderingError
from lunarsim.light import Light
from lunarsim.sensors.rendering import _cull_kernels as kernels
from lunarsim.sensors.rendering import _small_rock_kernels as small_rocks
from lunarsim.sensors.rendering.context import gl_context
from lunarsim.sensors.rendering.programs import (
    build_programs,
    columns,
    float_texture,
    set_uniforms,
    tile_mesh,
)
from lunarsim.sensors.rendering.relief_tiles import LEVELS, ReliefTiles
from lunarsim.sensors.rendering.target import Target, read_image
from lunarsim.sensors.rendering.view import Image, View
from lunarsim.terrain import Terrain
from lunarsim.terrain.shapes import shape_table

Array = NDArray[np.float64]

# Drawing the relief coarsely may move it by this share of its distance, and a shadow's edge by
# this share of a pixel.
_RANGE_ERROR = 4e-4
_SHADOW_ERROR = 0.5
# A texel of the shadow map is this much finer than a pixel on the ground.
_SHADOW_DETAIL = 1.5
_SHADOW_SIDE = 4096
_SHADOW_AREA = 6_000_000
# Within this share of a texel behind a lee face a point is dark: at the foot of a rock no light
# may leak in.
_OVERHANG = 0.6
_ROCK_TEXTURE = 1024


class Renderer:
    """All buffers of one terrain on the graphics device.

    Parameters
    ----------
    terrain
        What is drawn.

    Raises
    ------
    RenderingError
        Where OpenGL is missing or the relief has more posts than a texture can hold.
    """

    def __init__(self, terrain: Terrain) -> None:
        ctx = gl_context()
        self._ctx = ctx
        self._relief = terrain.relief
        relief = terrain.relief
        most = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
        if max(relief.z.shape) > most:
            raise RenderingError(f"the relief has {relief.z.shape} posts; this device holds {most}")
        g = relief.grid
        self._origin = np.array([g.x0, g.y0])
        self._tiles = ReliefTiles.of(relief)
        self._corners = self._tiles.corners()
        holes = () if np.isfinite(relief.z).all() else ("HOLES",)
        self._heights = float_texture(ctx, relief.z[:, :, None])
        self._slopes = float_texture(ctx, kernels.slopes(relief.z, g.posting))
        self._load_rocks(terrain)
        self._programs = build_programs(ctx, holes)
        self._meshes = [tile_mesh(ctx, level) for level in range(LEVELS)]
        self._tile_buffer = ctx.buffer(reserve=8 * len(self._tiles.first))
        self._vaos: dict[tuple[str, int], moderngl.VertexArray] = {}
        self._targets: dict[tuple[int, int, bool], Target] = {}
        self._shadow: tuple[moderngl.Texture, moderngl.Framebuffer] | None = None

    def _load_rocks(self, terrain: Terrain) -> None:
        rocks = terrain.rocks
        self._rows = rocks.rows()
        self._reach = rocks.reach()
        g = terrain.relief.grid
        self._feet = kernels.rock_feet(
            self._rows, self._reach, terrain.relief.z, g.x0, g.y0, g.posting
        )
        count = len(rocks)
        lines = max(1, -(-count // _ROCK_TEXTURE))
        texels = np.zeros((lines * _ROCK_TEXTURE, 12), np.float32)
        texels[:count, :9] = self._rows
        self._rock_texture = float_texture(self._ctx, texels.reshape(lines, 3 * _ROCK_TEXTURE, 4))
        self._box = np.empty((count, 4))
        self._box_buffer = self._ctx.buffer(reserve=max(16 * count, 16))
        self._number_buffer = self._ctx.buffer(reserve=max(4 * count, 4))
        self._shapes = shape_table()
        self._point_buffer = self._ctx.buffer(reserve=28)

    def render(
        self, view: View, light: Light, *, truth: bool = False, shadows: bool = True
    ) -> Image:
        """Draw the terrain.

        Parameters
        ----------
        view, light
            Camera and Sun.
        truth
            Whether to return range, normal and identity too; the relief is then drawn at its
            finest level.
        shadows
            Whether points can shade each other.

        Raises
        ------
        InputError
            If the camera is under the ground.
        """
        self._check_above_ground(view)
        sun = light.direction
        lit = sun[2] > 0.0
        near, far = self._clip(view)
        shown = self._tiles_in(view, near)
        level = self._levels(view, sun, shown, truth)
        target = self._target(view.width, view.height, truth)
        with self._ctx.scope(target.picture, moderngl.DEPTH_TEST):
            shadow: dict[str, Any] = {"shaded": 0, "shadow": 2}
            if lit and shadows and shown.any():
                shadow = self._draw_shadows(view, sun, shown, level)
            values = self._view_values(view, near, far)
            target.rocks.use()
            target.rocks.clear(depth=1.0)
            target.depth_only.use()
            self._draw_relief("relief", values, shown, level)
            target.rocks.use()
            box, number = self._boxes(view, near)
            small, start, rest = small_rocks.split(box)
            self._draw_rocks("rocks", values, box[rest], number[rest])
            points, hit = small_rocks.sight(
                self._rows, self._shapes.planes, self._shapes.count, box, number, small, start,
                view.position, np.ascontiguousarray(view.axes.T), view.fx, view.fy, view.cx,
                view.cy, near, far,
            )  # fmt: skip
            self._draw_points("small-rocks", values, points[hit])
            target.picture.use()
            self._ctx.disable(moderngl.DEPTH_TEST)
            target.picture.clear()
            self._shade(target, values | _light_values(light, sun) | shadow, truth)
            return read_image(target, view, truth)

    def _shade(self, target: Target, values: dict[str, Any], truth: bool) -> None:
        name = "shade-truth" if truth else "shade"
        self._slopes.use(1)
        target.depth.use(3)
        target.stones.use(4)
        program = self._programs[name]
        set_uniforms(program, values | {"slopes": 1, "depths": 3, "stones": 4})
        if (name, 0) not in self._vaos:
            self._vaos[name, 0] = self._ctx.vertex_array(program, [])
        self._vaos[name, 0].render(moderngl.TRIANGLES, vertices=3)

    def _check_above_ground(self, view: View) -> None:
        e, n, up = view.position
        g = self._relief.grid
        u, v = (e - g.x0) / g.posting, (n - g.y0) / g.posting
        if 0.0 <= u <= g.cols - 1 and 0.0 <= v <= g.rows - 1:
            i, j = min(int(v), g.rows - 2), min(int(u), g.cols - 2)
            ground = float(np.max(self._relief.z[i : i + 2, j : j + 2]))
            if up <= ground:
                raise InputError(
                    "camera.position", [float(x) for x in view.position],
                    f"a point above the ground, which is at {ground:.2f} m there",
                )  # fmt: skip

    def _clip(self, view: View) -> tuple[float, float]:
        """Return the least and greatest depth that anything can have, m."""
        along = (self._corners.reshape(-1, 3) - view.position) @ view.axes[:, 2]
        far = max(float(along.max(initial=1.0)) * 1.01 + 10.0, 1.0)
        tallest = float(self._rows[:, 5].max(initial=0.0))
        # No ray meets anything before it has come down to the highest rock.
        steepest = np.linalg.norm([self._tan(view), 1.0])
        drop = float(view.position[2] - self._tiles.high[:, 2].max() - tallest)
        return max(0.5 * drop / float(steepest), 2e-4 * far, 0.02), far

    @staticmethod
    def _tan(view: View) -> float:
        """Return the tangent of the angle between boresight and the farthest corner."""
        u = max(view.cx + 0.5, view.width - 0.5 - view.cx) / view.fx
        v = max(view.cy + 0.5, view.height - 0.5 - view.cy) / view.fy
        return float(np.hypot(u, v))

    def _tiles_in(self, view: View, near: float) -> NDArray[np.bool_]:
        """Return which tiles may be in the picture."""
        s = (self._corners - view.position) @ view.axes
        x, y, z = s[..., 0], s[..., 1], s[..., 2]
        left, right = (-0.5 - view.cx) / view.fx, (view.width - 0.5 - view.cx) / view.fx
        top, bottom = (-0.5 - view.cy) / view.fy, (view.height - 0.5 - view.cy) / view.fy
        out = (
            (z < near).all(1)
            | (x < left * z).all(1)
            | (x > right * z).all(1)
            | (y < top * z).all(1)
            | (y > bottom * z).all(1)
        )
        return np.asarray(~out)

    def _levels(
        self, view: View, sun: Array, shown: NDArray[np.bool_], truth: bool
    ) -> NDArray[np.int64]:
        if truth:
            return np.zeros(shown.size, np.int64)
        distance = self._tiles.distance(view.position)
        pixel = distance / max(view.fx, view.fy)
        shift = _SHADOW_ERROR * pixel * max(sun[2], 0.02) / max(np.hypot(sun[0], sun[1]), 1e-6)
        return self._tiles.level(np.minimum(_RANGE_ERROR * distance, shift))

    def _view_values(self, view: View, near: float, far: float) -> dict[str, Any]:
        g = self._relief.grid
        posts = (view.position[:2] - self._origin) / g.posting
        cell = np.floor(posts)
        return {
            "to_sensor": columns(view.axes.T),
            "intrinsics": (view.fx, view.fy, view.cx, view.cy),
            "image": (float(view.width), float(view.height)),
            "clip": (near, far),
            "size": (g.cols, g.rows),
            "posting": g.posting,
            "eye": tuple(view.position),
            "eye_posts": tuple(posts),
            "eye_height": float(view.position[2]),
            "eye_cell": tuple(int(c) for c in cell),
            "eye_in_cell": tuple(posts - cell),
        }

    def _boxes(self, view: View, near: float) -> tuple[Array, NDArray[np.int32]]:
        seen = kernels.visible_rocks(
            self._rows, self._reach, self._feet, view.position,
            np.ascontiguousarray(view.axes.T), view.fx, view.fy, view.cx, view.cy,
            float(view.width), float(view.height), near, self._box,
        )  # fmt: skip
        box, number = kernels.gather(self._box, seen)
        return box, number

    def _draw_relief(
        self, name: str, values: dict[str, Any], shown: NDArray[np.bool_], level: NDArray[np.int64]
    ) -> None:
        program = self._programs[name]
        self._heights.use(0)
        set_uniforms(program, values | {"relief": 0})
        for k in range(LEVELS):
            picked = np.flatnonzero(shown & (level == k))
            if picked.size == 0:
                continue
            finite = self._tiles.error[: k + 1, picked]
            # Curtains would throw shadows, and where all tiles are finest there is no gap.
            bare = name == "relief-shadow" or not level[shown].any()
            skirt = 0.0 if bare else float(2.0 * finite.max() + 0.01)
            set_uniforms(program, {"skirt": skirt})
            if (name, k) not in self._vaos:
                posts, triangles = self._meshes[k]
                self._vaos[name, k] = self._ctx.vertex_array(
                    program, [(posts, "3i", "post"), (self._tile_buffer, "2i/i", "tile")], triangles
                )
            self._tile_buffer.orphan()
            self._tile_buffer.write(np.ascontiguousarray(self._tiles.first[picked]))
            self._vaos[name, k].render(instances=picked.size)

    def _draw_points(self, name: str, values: dict[str, Any], points: NDArray[np.float32]) -> None:
        """Draw what small rocks were found to cover (n, 7 or 3): place, depth, normal, number."""
        if len(points) == 0:
            return
        program = self._programs[name]
        set_uniforms(program, values)
        self._point_buffer.orphan(points.nbytes)
        self._point_buffer.write(points)
        if (name, 0) not in self._vaos:
            parts = ("3f 4f", "at", "stone") if points.shape[1] == 7 else ("3f", "at")
            self._vaos[name, 0] = self._ctx.vertex_array(program, [(self._point_buffer, *parts)])
        self._vaos[name, 0].render(moderngl.POINTS, vertices=len(points))

    def _draw_rocks(
        self, name: str, values: dict[str, Any], box: Array, number: NDArray[np.int32]
    ) -> None:
        if number.size == 0:
            return
        program = self._programs[name]
        self._rock_texture.use(3)
        set_uniforms(program, values | {"rocks": 3})
        if (name, 0) not in self._vaos:
            self._vaos[name, 0] = self._ctx.vertex_array(
                program, [(self._box_buffer, "4f/i", "box"), (self._number_buffer, "i/i", "number")]
            )
        self._box_buffer.orphan()
        self._box_buffer.write(box)
        self._number_buffer.orphan()
        self._number_buffer.write(number)
        self._vaos[name, 0].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=number.size)

    def _shadow_map(self) -> tuple[moderngl.Texture, moderngl.Framebuffer]:
        if self._shadow is None:
            texture = self._ctx.depth_texture((_SHADOW_SIDE, _SHADOW_SIDE))
            texture.compare_func = ""
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._shadow = texture, self._ctx.framebuffer(depth_attachment=texture)
        return self._shadow

    def _draw_shadows(
        self, view: View, sun: Array, shown: NDArray[np.bool_], level: NDArray[np.int64]
    ) -> dict[str, Any]:
        """Draw the shadow map; return what the other shaders need to read it."""
        tiles = self._tiles
        horizontal = float(np.hypot(sun[0], sun[1]))
        lean = sun[:2] / sun[2]
        along = sun[:2] / horizontal if horizontal > 1e-9 else np.array([1.0, 0.0])
        axes = np.array([along, [-along[1], along[0]]])
        corner, extent = _map_extent(view, tiles, shown, lean, axes, self._tallest_rock())
        distance = max(float(tiles.distance(view.position)[shown].min()), 1e-3)
        texel = distance / max(view.fx, view.fy) / _SHADOW_DETAIL
        texel = max(texel, extent.max() / _SHADOW_SIDE, np.sqrt(np.prod(extent) / _SHADOW_AREA))
        size = np.minimum(np.ceil(extent / texel).astype(int).clip(1), _SHADOW_SIDE)
        place = self._corners - view.position
        place = (place[..., :2] - place[..., 2:] * lean) @ axes.T
        shades = (place.max(1) >= corner).all(1) & (place.min(1) <= corner + texel * size).all(1)
        highest = float(tiles.high[:, 2].max()) + self._tallest_rock() - view.position[2] + 1.0
        lowest = float(min(tiles.low[:, 2].min(), self._feet.min(initial=np.inf)))
        heights = (highest, lowest - view.position[2] - 1.0)
        span = texel * size
        texture, frame = self._shadow_map()
        frame.viewport = (0, 0, int(size[0]), int(size[1]))
        frame.use()
        # Clear no more than is used.
        self._ctx.clear(depth=1.0, viewport=(0, 0, int(size[0]), int(size[1])))
        map_axes = axes / span[:, None]
        values = self._view_values(view, 1.0, 2.0) | {
            "lean": tuple(lean),
            "map_axes": columns(map_axes),
            "map_origin": tuple(corner / span),
            "heights": heights,
            "from_map": columns(axes.T * texel),
            "map_corner": tuple(axes.T @ corner),
            "image": (float(size[0]), float(size[1])),
        }
        # Only a face steeper than the sunrays is turned away from the Sun.
        steep = tiles.steepness * horizontal > sun[2]
        self._ctx.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._ctx.cull_face = "front"
        self._draw_relief("relief-shadow", values, shades & steep, level)
        patched = int(np.unique(level[shades & steep]).size > 1)
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        boxes = kernels.shading_rocks(
            self._rows, self._reach, self._feet, view.position, lean, axes, corner, texel,
            float(size[0]), float(size[1]), self._box,
        )  # fmt: skip
        box, number = kernels.gather(self._box, boxes)
        small, start, rest = small_rocks.split(box)
        self._draw_rocks("rocks-shadow", values, box[rest], number[rest])
        points, hit = small_rocks.shade(
            self._rows, self._shapes.planes, self._shapes.count, box, number, small, start,
            view.position, lean, axes, corner, texel, *heights,
        )  # fmt: skip
        self._draw_points("small-rocks-shadow", values, points[hit])
        texture.use(2)
        return {
            "shaded": 1, "patched": patched, "shadow": 2, "lean": tuple(lean),
            "map_axes": columns(map_axes),
            "map_origin": tuple(corner / span), "heights": heights,
            "slack": -_OVERHANG * texel * min(sun[2] / max(horizontal, 1e-9), 2.0),
            "map_size": (float(size[0]), float(size[1])),
        }  # fmt: skip

    def _tallest_rock(self) -> float:
        return float(self._rows[:, 5].max(initial=0.0))

    def _target(self, width: int, height: int, truth: bool) -> Target:
        key = (width, height, truth)
        if key not in self._targets:
            self._targets[key] = Target.of(self._ctx, width, height, (4, 2) if truth else (1,))
        return self._targets[key]


_RENDERERS: dict[int, Renderer] = {}


def renderer_of(terrain: Terrain) -> Renderer:
    """Return the terrain's renderer, made once and kept as long as the terrain lives."""
    key = id(terrain)
    if key not in _RENDERERS:
        _RENDERERS[key] = Renderer(terrain)
        # Its buffers are freed when the last reference to the renderer goes.
        weakref.finalize(terrain, _RENDERERS.pop, key, None).atexit = False
    return _RENDERERS[key]


def _light_values(light: Light, sun: Array) -> dict[str, Any]:
    return {
        "sun": tuple(sun),
        "albedo": light.albedo,
        "ambient": light.ambient,
        "lunar_lambert": int(light.photometry == "lunar-lambert"),
    }


def _map_extent(
    view: View, tiles: ReliefTiles, shown: NDArray[np.bool_], lean: Array, axes: Array, rock: float
) -> tuple[Array, Array]:
    """Return corner (2,) and extent (2,) of the shadow map, m, in its axes about the camera.

    It must hold the places of all that is seen: the part of the view's pyramid between the
    lowest and the highest elevation in it, and inside the tiles in it.
    """
    low, high = tiles.low[shown].min(0), tiles.high[shown].max(0) + np.array([0.0, 0.0, rock])
    u = np.array([-0.5, view.width - 0.5]) - view.cx
    v = np.array([-0.5, view.height - 0.5]) - view.cy
    border = np.array([[a / view.fx, b / view.fy, 1.0] for a in u for b in v]) @ view.axes.T
    # Rays that come down beyond the tiles, or not at all, end well beyond the tiles, on the level
    # all the same: cut off in mid-air they would leave out the ground below.
    reach = 3.0 * np.linalg.norm(np.maximum(high - view.position, view.position - low)[:2])
    seen = []
    for ray in border:
        run = np.hypot(ray[0], ray[1])
        for level in (low[2], high[2]):
            drop = level - view.position[2]
            t = drop / ray[2] if ray[2] * drop > 0.0 else np.inf
            t = min(t, reach / max(run, 1e-9))
            seen.append([t * ray[0], t * ray[1], drop])
    box = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                    for z in (low[2], high[2])]) - view.position  # fmt: skip
    in_view, in_box = (
        (points[:, :2] - points[:, 2:] * lean) @ axes.T for points in (np.array(seen), box)
    )
    least = np.maximum(in_view.min(0), in_box.min(0))
    most = np.minimum(in_view.max(0), in_box.max(0))
    margin = 0.01 * np.maximum(most - least, 0.0) + 1e-3
    return least - margin, np.maximum(most - least, 0.0) + 2.0 * margin
