"""What a picture is drawn into, and how it is read back."""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np

from lunarsim.sensors.rendering.view import Image, View


@dataclass(frozen=True)
class Target:
    """What a picture of one size is drawn into: depth and rocks first, then the picture."""

    depth: moderngl.Texture
    stones: moderngl.Texture
    colours: tuple[moderngl.Texture, ...]
    depth_only: moderngl.Framebuffer
    rocks: moderngl.Framebuffer
    picture: moderngl.Framebuffer

    @classmethod
    def of(cls, ctx: moderngl.Context, width: int, height: int, parts: tuple[int, ...]) -> Target:
        """Make the textures of a picture; `parts` are the channels of its colour outputs."""
        size = (width, height)
        depth = ctx.depth_texture(size)
        depth.compare_func = ""
        depth.filter = (moderngl.NEAREST, moderngl.NEAREST)
        stones = ctx.texture(size, 4, dtype="f4")
        colours = tuple(ctx.texture(size, n, dtype="f4") for n in parts)
        return cls(
            depth,
            stones,
            colours,
            ctx.framebuffer(depth_attachment=depth),
            ctx.framebuffer([stones], depth),
            ctx.framebuffer(list(colours)),
        )


def read_image(target: Target, view: View, truth: bool) -> Image:
    """Return the picture that has been drawn."""
    shape = (view.height, view.width)
    first = np.frombuffer(target.colours[0].read(), np.float32)
    if not truth:
        return Image(first.reshape(shape))
    first = first.reshape(*shape, 4)
    second = np.frombuffer(target.colours[1].read(), np.float32).reshape(*shape, 2)
    identity = second[..., 1].astype(np.int32) - 2
    sky = identity == -2
    normal = first[..., 1:].copy()
    normal[sky] = np.nan
    distance = np.where(sky, np.float32(np.nan), second[..., 0])
    return Image(np.ascontiguousarray(first[..., 0]), distance, normal, identity)
