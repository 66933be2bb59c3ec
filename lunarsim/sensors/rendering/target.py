"""Framebuffers of images and shadow maps, and reading of rendered images."""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np

from lunarsim.models.pinhole import View
from lunarsim.sensors.rendered_image import RenderedImage
from lunarsim.sensors.rendering.programs import disable_filtering

# Factor on each side of a shadow map, so that it fits images of slightly different sizes.
_SIZE_MARGIN = 1.15


@dataclass(frozen=True)
class ImageTarget:
    """Framebuffers of images of one size.

    The depth of the relief is drawn first, then its image. Rocks follow, tested against that depth
    or, if the relief was drawn at reduced resolution, against a corrected depth.

    Attributes
    ----------
    depth, corrected_depth
        Depth of the relief as drawn, and corrected depth.
    colours
        Outputs of the shaders: radiance and, if requested, range, normal and identity.
    depth_only
        Framebuffer for the depth of the relief.
    image_buffer, depth_test_buffer, corrected_depth_test_buffer
        Framebuffers for the outputs: without a depth test, with a test against `depth`, and with a
        test against `corrected_depth`.
    """

    depth: moderngl.Texture
    corrected_depth: moderngl.Texture
    colours: tuple[moderngl.Texture, ...]
    depth_only: moderngl.Framebuffer
    image_buffer: moderngl.Framebuffer
    depth_test_buffer: moderngl.Framebuffer
    corrected_depth_test_buffer: moderngl.Framebuffer

    @classmethod
    def of(
        cls, ctx: moderngl.Context, width: int, height: int, channels: tuple[int, ...]
    ) -> ImageTarget:
        """Create the framebuffers of an image of `width` x `height` pixels.

        `channels` are the numbers of channels of the colour outputs.
        """
        size = (width, height)
        depth, corrected_depth = ctx.depth_texture(size), ctx.depth_texture(size)
        depth.compare_func = ""
        disable_filtering(depth)
        colours = tuple(ctx.texture(size, n, dtype="f4") for n in channels)
        return cls(
            depth,
            corrected_depth,
            colours,
            ctx.framebuffer(depth_attachment=depth),
            ctx.framebuffer(list(colours)),
            ctx.framebuffer(list(colours), depth),
            ctx.framebuffer(list(colours), corrected_depth),
        )


@dataclass(frozen=True)
class ShadowMap:
    """Framebuffer of a shadow map: the minimum depth of everything that casts shadows."""

    texture: moderngl.Texture
    buffer: moderngl.Framebuffer

    @classmethod
    def of(cls, ctx: moderngl.Context, size: tuple[int, int]) -> ShadowMap:
        """Create a shadow map of at least `size` (width, height) texels."""
        # The extra columns prevent cache conflicts between rows a power of two apart.
        width, height = (64 * -(-int(_SIZE_MARGIN * n) // 64) for n in size)
        texture = ctx.texture((width + 16, height), 1, dtype="f4")
        disable_filtering(texture)
        return cls(texture, ctx.framebuffer([texture]))

    def suits(self, size: tuple[int, int]) -> bool:
        """Return whether the map can be used for `size` (width, height) texels.

        It must be large enough, but not much larger.
        """
        width, height = self.texture.width, self.texture.height
        fits = size[0] <= width and size[1] <= height
        return fits and width * height < int(_SIZE_MARGIN**3 * (size[0] + 80) * (size[1] + 64))


def read_image(target: ImageTarget, view: View, truth: bool) -> RenderedImage:
    """Read the rendered image from the graphics memory.

    `truth` is whether range, normal and identity were also rendered.
    """
    shape = (view.height, view.width)
    first = np.frombuffer(target.colours[0].read(), np.float32)
    if not truth:
        return RenderedImage(first.reshape(shape))
    first = first.reshape(*shape, 4)
    second = np.frombuffer(target.colours[1].read(), np.float32).reshape(*shape, 2)
    identity = second[..., 1].astype(np.int32) - 2
    sky = identity == -2
    normal = first[..., 1:].copy()
    normal[sky] = np.nan
    distance = np.where(sky, np.float32(np.nan), second[..., 0])
    return RenderedImage(np.ascontiguousarray(first[..., 0]), distance, normal, identity)
