"""Renderer of images of one terrain.

The relief is drawn as tiles of triangles at a level of detail whose error stays below a fraction
of a pixel; its normals always come from the finest triangles. A rock is drawn as a screen box in
which the shader intersects the exact shape. Shadows come from a map along the Sun's rays of the
highest faces turned away from the Sun: a lit face is never in the map, so that no face shadows
itself.
"""

from __future__ import annotations

import weakref
from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, RenderingError
from lunarsim.models.pinhole import View, check_finite_position
from lunarsim.sensors.rendered_image import RenderedImage
from lunarsim.sensors.rendering.albedo_field import rock_albedos
from lunarsim.sensors.rendering.context import gl_context, on_render_thread
from lunarsim.sensors.rendering.frame_block import FRAME, frame_block
from lunarsim.sensors.rendering.penumbra import PenumbraBounds, sun_disc_axes
from lunarsim.sensors.rendering.programs import (
    BLOCK,
    DEPTHS,
    SHADOW,
    geometry_programs,
    shading_program_name,
    shading_programs,
)
from lunarsim.sensors.rendering.relief_renderer import ReliefRenderer
from lunarsim.sensors.rendering.relief_tiles import TileChoice
from lunarsim.sensors.rendering.rock_renderer import RockRenderer
from lunarsim.sensors.rendering.rock_tiles import DrawnRocks
from lunarsim.sensors.rendering.shading_model import ShadingModel
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.sensors.rendering.shadow_map_reads import ShadowMapReads
from lunarsim.sensors.rendering.surface_textures import SurfaceTextures
from lunarsim.sensors.rendering.target import ImageTarget, ShadowMap, read_image
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.world.light import Light
from lunarsim.world.terrain import Terrain

# Maximum displacement by coarse relief: of a point, over its distance, and of a shadow's edge, in
# pixels.
_RANGE_ERROR = 4e-4
_SHADOW_ERROR_PX = 0.5
# If the grid spacing is smaller than this many texels of the shadow map, ridges may be narrower
# than a texel.
_NARROW_RIDGE_TEXELS = 4.0


class Renderer:
    """Renderer of images of one terrain, usable from any thread.

    Parameters
    ----------
    terrain
        Terrain to render.

    Raises
    ------
    RenderingError
        If OpenGL is missing or the relief has more grid points than a texture can hold.
    """

    @on_render_thread
    def __init__(self, terrain: Terrain) -> None:
        ctx = gl_context()
        self._ctx = ctx
        relief = terrain.relief
        self._relief = relief
        max_size = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
        if max(relief.z.shape) > max_size:
            raise RenderingError(
                f"The relief has {' x '.join(map(str, relief.z.shape))} grid points, but this "
                "graphics "
                f"device allows at most {max_size} per side."
            )
        holes = () if np.isfinite(relief.z).all() else ("HOLES",)
        self._programs = geometry_programs(ctx, holes)
        self._ground = ReliefRenderer(ctx, self._programs, relief)
        self._rocks = RockRenderer(ctx, self._programs, terrain)
        tiles = self._ground.tiles
        self._tiles = tiles
        self._corners = tiles.corners()
        some = tiles.low.size > 0
        self._lowest = float(tiles.low[:, 2].min()) if some else 0.0
        self._highest = float(tiles.high[:, 2].max()) if some else 0.0
        self._block = ctx.buffer(reserve=FRAME.itemsize)
        self._screens: dict[moderngl.Program, moderngl.VertexArray] = {}
        self._targets: dict[tuple[int, int, bool], ImageTarget] = {}
        self._shadow: ShadowMap | None = None
        self._bounds: PenumbraBounds | None = None
        self._surface = SurfaceTextures(ctx, terrain)

    @on_render_thread
    def render(
        self, view: View, light: Light, *, truth: bool = False, shadows: bool = True
    ) -> RenderedImage:
        """Render an image of the terrain.

        Parameters
        ----------
        view, light
            Camera view (pose, projection and image size), and light.
        truth
            Whether to return range, normal and identity; the relief is then drawn at its finest
            level.
        shadows
            Whether to compute shadows.

        Returns
        -------
        RenderedImage
            Radiance factor and, if requested, range, normal and identity of every pixel.

        Raises
        ------
        InputError
            If the camera is below the terrain or its pose is not valid.
        """
        self._check(view)
        sun = light.direction
        clip = self._clip(view)
        choice = self._choose_tiles(view, sun, clip[0])
        if truth:
            finest = np.zeros_like(choice.level)
            choice = replace(choice, level=finest, shadow_level=finest)
        target = self._target(view.width, view.height, truth)
        frame = None
        if sun[2] > 0.0 and shadows and choice.shown.any():
            frame = self._shadow_frame(view, sun, choice)
        size = (1, 1) if self._shadow is None else self._shadow.texture.size
        block = frame_block(
            view, clip, light, self._relief.grid, self._ground.corners.size, self._ground.datum,
            frame, size,
        )  # fmt: skip
        shades = self._shading_tiles(view, sun, frame)
        reach = self._set_penumbra(block, frame, light, bool(shades.any()))
        programs = self._set_surface(block, light, view, wide=reach > 1.0)
        self._upload_frame(block)
        seen = self._rocks.visible_rocks(view, clip[0])
        with self._ctx.scope(target.image_buffer, moderngl.DEPTH_TEST):
            leaks = False
            if frame is not None:
                reads = self._map_reads(view, frame, choice, seen, reach)
                leaks = self._draw_shadows(view, sun, frame, reads, shades, choice.shadow_level)
                if reach > 1.0:
                    self._penumbra_bounds().draw(frame, block["penumbra"][:2], reach)
            target.depth_only.use()
            target.depth_only.clear(depth=1.0)
            matrix = _camera_matrix(view, *clip)
            self._ground.draw(matrix, view.position, choice.shown, choice.level)
            coarse = bool(choice.level[choice.shown].any())
            rock_buffer = target.corrected_depth_test_buffer if coarse else target.depth_test_buffer
            name = shading_program_name(coarse=coarse, leaks=leaks, truth=truth)
            self._shade_relief(target, rock_buffer, coarse, programs[name])
            rock_buffer.use()
            self._rocks.draw(programs, view, clip[0], seen, truth)
            return read_image(target, view, truth)

    def _upload_frame(self, block: NDArray[np.void]) -> None:
        """Pass the parameters of an image (its uniform block) to the shaders."""
        self._block.orphan()
        self._block.write(block.tobytes())
        self._block.bind_to_uniform_block(0)

    def _shade_relief(
        self,
        target: ImageTarget,
        rock_buffer: moderngl.Framebuffer,
        coarse: bool,
        program: moderngl.Program,
    ) -> None:
        """Shade the relief; correct its depth if it was drawn at reduced resolution.

        `target` are the framebuffers of the image; `rock_buffer` is the one into which rocks are
        drawn later. `coarse` is whether the resolution was reduced, and `program` the shader.
        """
        if coarse:
            rock_buffer.use()
            rock_buffer.clear(depth=1.0)
            self._ctx.depth_func = "1"
        else:
            target.image_buffer.use()
            target.image_buffer.clear()
            self._ctx.disable(moderngl.DEPTH_TEST)
        target.depth.use(DEPTHS)
        if program not in self._screens:
            self._screens[program] = self._ctx.vertex_array(program, [])
        self._screens[program].render(moderngl.TRIANGLES, vertices=3)
        self._ctx.enable(moderngl.DEPTH_TEST)
        self._ctx.depth_func = "<"

    def _check(self, view: View) -> None:
        """Raise InputError if the camera's pose is not valid or is below the terrain."""
        check_finite_position(view.position)
        if not np.allclose(view.axes.T @ view.axes, np.eye(3), atol=1e-3):
            raise InputError(
                "camera.axes", view.axes.tolist(), "must be a rotation matrix (3, 3)",
                show_value=False,
            )  # fmt: skip

        e, n, up = view.position
        g = self._relief.grid
        u, v = (e - g.x0) / g.posting, (n - g.y0) / g.posting
        if 0.0 <= u <= g.cols - 1 and 0.0 <= v <= g.rows - 1:
            i, j = min(int(v), g.rows - 2), min(int(u), g.cols - 2)
            terrain_height = float(np.max(self._relief.z[i : i + 2, j : j + 2]))
            if up <= terrain_height:
                raise InputError(
                    "camera.position", [float(x) for x in view.position],
                    f"must be above the terrain at {terrain_height:.2f} m, but has a height of "
                    f"{up:.2f} m",
                    show_value=False,
                )  # fmt: skip

    def _clip(self, view: View) -> tuple[float, float]:
        """Return bounds of the depth, m, of all visible points: minimum and maximum."""
        along = (self._corners.reshape(-1, 3) - view.position) @ view.axes[:, 2]
        far = max(float(along.max(initial=1.0)) * 1.01 + 10.0, 1.0)
        # No ray hits anything before it descends to the top of the highest rock.
        steepest = np.linalg.norm([self._corner_tangent(view), 1.0])
        drop = float(view.position[2] - self._highest - self._rocks.tallest)
        return max(0.5 * drop / float(steepest), 2e-4 * far, 0.02), far

    @staticmethod
    def _corner_tangent(view: View) -> float:
        """Return the tangent of the angle between boresight and farthest image corner."""
        left, right, upper, lower = view.border_tangents
        return float(np.hypot(max(-left, right), max(-upper, lower)))

    def _choose_tiles(self, view: View, sun: Array, near: float) -> TileChoice:
        """Select the visible tiles of the relief and their levels of detail.

        `sun` (3,) is the unit vector to the Sun and `near` the minimum depth, m.
        """
        run = max(sun[2], 0.02) / max(float(np.hypot(sun[0], sun[1])), 1e-6)
        shift = min(_RANGE_ERROR, _SHADOW_ERROR_PX / max(view.fx, view.fy) * run)
        bounds = np.array(view.border_tangents)
        return self._tiles.choose(view.position, view.axes, bounds, near, _RANGE_ERROR, shift)

    def _shadow_frame(self, view: View, sun: Array, choice: TileChoice) -> ShadowFrame:
        """Return area and resolution of the shadow map, and allocate a map of this size.

        `sun` (3,) is the unit vector to the Sun, and `choice` are the visible tiles.
        """
        rock = self._rocks.tallest
        lowest = min(self._lowest, self._rocks.lowest)
        frame = ShadowFrame.of(view, sun, choice, self._highest + rock, lowest, rock)
        if self._shadow is None or not self._shadow.suits(frame.size):
            self._shadow = self._bounds = None
            self._ctx.gc()  # frees the old map before a new one is allocated
            self._shadow = ShadowMap.of(self._ctx, frame.size)
        return frame

    def _penumbra_bounds(self) -> PenumbraBounds:
        """Return the depth bounds of the current shadow map; create them if needed."""
        if self._bounds is None:
            assert self._shadow is not None
            self._bounds = PenumbraBounds(self._ctx, self._programs, self._shadow)
        return self._bounds

    def _set_surface(
        self, block: NDArray[np.void], light: Light, view: View, *, wide: bool
    ) -> dict[str, moderngl.Program]:
        """Bind the surface textures and albedos; return the shader programs for a light.

        `wide` is whether penumbrae are wider than a texel. The coordinate transforms of the
        textures are written into `block`, the uniform block of the image.
        """
        self._surface.use(light, view.position, block)
        if light.boulder_albedo_variation > 0.0 or light.boulder_albedo != 1.0:
            self._rocks.set_albedo(rock_albedos(light, self._rocks.count))
        model = ShadingModel.of(light, has_albedo_map=self._surface.has_albedo_map)
        return shading_programs(self._ctx, model.with_wide_penumbrae() if wide else model)

    def _set_penumbra(
        self, block: NDArray[np.void], frame: ShadowFrame | None, light: Light, relief_shades: bool
    ) -> float:
        """Write the size of the Sun's disc in the shadow map into the uniform block.

        Returns half the width of the widest penumbra, texels. For a point Sun or without a shadow
        map (`frame` None) the result is 0 and nothing is written. `relief_shades` is whether the
        relief casts shadows.
        """
        if frame is None or light.diameter == 0.0:
            return 0.0
        axes = sun_disc_axes(frame, light.direction, light.diameter)
        high = self._rocks.tallest
        if relief_shades:
            high += self._highest - self._lowest
        range_ = frame.heights[0] - frame.heights[1]
        half_width = float(axes.max()) * min(high, range_)
        block["penumbra"][:2] = axes * range_
        if half_width > 1.0:
            block["penumbra"][2:] = 1.0 / (BLOCK * np.array(self._penumbra_bounds().size))
        return half_width

    def _shading_tiles(self, view: View, sun: Array, frame: ShadowFrame | None) -> BoolArray:
        """Return which tiles (n,) may cast shadows onto the area of the shadow map.

        `sun` (3,) is the unit vector to the Sun. Without a shadow map (`frame` None), no tile does.
        """
        if frame is None:
            return np.zeros(len(self._corners), np.bool_)
        # Only a face steeper than the Sun's rays is turned away from the Sun.
        steep = self._tiles.steepness * float(np.hypot(sun[0], sun[1])) > sun[2]
        return np.asarray(steep & frame.shades(self._corners, view.position))

    def _map_reads(
        self,
        view: View,
        frame: ShadowFrame,
        choice: TileChoice,
        visible_rocks: DrawnRocks,
        penumbra_half_width: float,
    ) -> ShadowMapReads:
        """Return which part of the shadow map an image reads.

        `choice` are the visible tiles, and `penumbra_half_width` is that of the widest penumbra,
        texels. With penumbrae wider than a texel, the image may read any part.
        """
        if penumbra_half_width > 1.0:  # the search for penumbrae may read any texel
            return ShadowMapReads.anywhere(frame)
        low, high = self._rocks.elevation_bounds(visible_rocks)
        low, high = min(low, float(choice.low[2])), max(high, float(choice.high[2]))
        if not np.isfinite([low, high]).all():
            return ShadowMapReads.anywhere(frame)
        return ShadowMapReads.of(view, frame, low, high)

    def _draw_shadows(
        self, view: View, sun: Array, frame: ShadowFrame, reads: ShadowMapReads,
        shades: BoolArray, level: IntArray,
    ) -> bool:  # fmt: skip
        """Draw the shadow map; return whether light may leak through narrow ridges.

        `reads` is the part that the image reads, `shades` (n,) are the tiles that may cast shadows,
        and `level` (n,) their levels of detail.
        """
        shadow = self._shadow
        assert shadow is not None
        shadow.buffer.use()
        self._ctx.enable_only(moderngl.BLEND)
        self._ctx.blend_equation = moderngl.MIN  # type: ignore[assignment]
        self._rocks.draw_shadows(view, frame, reads, shadow)
        self._ctx.enable_only(moderngl.BLEND | moderngl.CULL_FACE)
        self._ctx.cull_face = "front"
        drawn = shades.copy()
        drawn[shades] = reads.may_shade(frame.texels_of(self._corners[shades] - view.position))
        self._ground.draw_shadows(frame, sun, view.position, drawn, level)
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        shadow.texture.use(SHADOW)
        return bool(shades.any()) and self._relief.grid.posting < _NARROW_RIDGE_TEXELS * frame.texel

    def _target(self, width: int, height: int, truth: bool) -> ImageTarget:
        key = (width, height, truth)
        if key not in self._targets:
            self._targets[key] = ImageTarget.of(self._ctx, width, height, (4, 2) if truth else (1,))
        return self._targets[key]


_RENDERERS: dict[int, Renderer] = {}


@on_render_thread
def renderer_of(terrain: Terrain) -> Renderer:
    """Return the renderer of a terrain, cached as long as the terrain exists."""
    key = id(terrain)
    if key not in _RENDERERS:
        _RENDERERS[key] = Renderer(terrain)
        # The buffers are freed when the last reference to the renderer is deleted.
        weakref.finalize(terrain, _RENDERERS.pop, key, None).atexit = False
    return _RENDERERS[key]


def _camera_matrix(view: View, near: float, far: float) -> Array:
    """Return the matrix (4, 4) from metres relative to the camera to clip coordinates.

    `near` and `far` are the minimum and maximum depth, m; input axes are ENU.
    """
    x, y, z = view.axes.T
    out = np.zeros((4, 4))
    # The centre of the first pixel is at 0; image rows increase upwards in clip coordinates.
    out[0, :3] = 2.0 * view.fx / view.width * x + ((2.0 * view.cx + 1.0) / view.width - 1.0) * z
    out[1, :3] = 2.0 * view.fy / view.height * y + ((2.0 * view.cy + 1.0) / view.height - 1.0) * z
    out[2, :3] = (far + near) / (far - near) * z
    out[2, 3] = -2.0 * far * near / (far - near)
    out[3, :3] = z
    return out
