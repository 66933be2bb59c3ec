"""Programs, meshes and textures of one context, and how values reach them."""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunarsim.rocks.shapes import CUBE, shape_table
from lunarsim.sensors.rendering.context import shader
from lunarsim.sensors.rendering.relief_tiles import LEVELS, level_mesh

Array = NDArray[np.float64]


def float_texture(ctx: moderngl.Context, data: NDArray[Any]) -> moderngl.Texture:
    """Return an array (rows, cols, parts) as a float32 texture without filtering.

    Rows that are a power of two apart fall on the same places of a processor's cache: such an array
    gets a few columns more, as the last one.
    """
    data = np.ascontiguousarray(data, np.float32)
    if data.strides[0] % 1024 == 0:
        data = np.pad(data, ((0, 0), (0, 16), (0, 0)), mode="edge")
    rows, cols, parts = data.shape
    texture = ctx.texture((cols, rows), parts, data.tobytes(), dtype="f4")
    plain(texture)
    return texture


def plain(texture: moderngl.Texture) -> None:
    """Have a texture read as it is: the nearest texel, the last one beyond its edge."""
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.repeat_x = texture.repeat_y = False


@lru_cache(maxsize=LEVELS)
def tile_mesh(ctx: moderngl.Context, level: int) -> tuple[moderngl.Buffer, moderngl.Buffer]:
    """Return the vertices and triangles of one level of detail; all terrains share them."""
    posts, triangles = level_mesh(level)
    return ctx.buffer(posts.tobytes()), ctx.buffer(triangles.tobytes())


# Texture units, and what the shaders call them.
CORNERS, SHADOW, DEPTHS, ROCKS = range(4)
_UNITS = {
    "corners": CORNERS,
    "shadow": SHADOW,
    "depths": DEPTHS,
    "rocks": ROCKS,
}

# Rocks are drawn by one program a kind: a driver that works on many pixels at once would run the
# code of every kind for each of them.
ROCK_KINDS = ("half-sphere", "cube", "hull")


def shade_name(*, coarse: bool, leaks: bool, truth: bool) -> str:
    """Return the name of the program that shades the relief.

    Parameters
    ----------
    coarse
        Whether the relief was drawn coarsely.
    leaks
        Whether light may leak through ridges in the shadow map.
    truth
        Whether range, normal and identity are drawn too.
    """
    return "shade" + "-coarse" * coarse + "-leaks" * leaks + "-truth" * truth


@lru_cache(maxsize=2)
def build_programs(ctx: moderngl.Context, holes: tuple[str, ...]) -> dict[str, moderngl.Program]:
    """Return all programs; terrains of one context share them."""
    programs = {
        "relief": ctx.program(
            shader("relief_vertex", defines=holes), shader("depth_fragment", defines=holes)
        ),
        "relief-shadow": ctx.program(
            shader("relief_vertex", defines=holes), shader("relief_shadow_fragment", defines=holes)
        ),
        "small-rocks-shadow": ctx.program(
            shader("frame", "small_rock_shadow_vertex"), shader("small_rock_shadow_fragment")
        ),
    }
    lit = ("frame", "light", "given_light")
    for suffix, truth in (("", ()), ("-truth", ("TRUTH",))):
        for coarse, leaks in product((False, True), repeat=2):
            kind = (("COARSE",) if coarse else ()) + (("LEAKS",) if leaks else ())
            programs[shade_name(coarse=coarse, leaks=leaks, truth=bool(truth))] = ctx.program(
                shader(*lit, "screen_vertex"),
                shader("light", "paint", "shade_fragment", defines=(*truth, *kind)),
            )
        programs[f"small-rocks{suffix}"] = ctx.program(
            shader(*lit, "small_rock_vertex", defines=truth),
            shader("paint", "small_rock_fragment", defines=truth),
        )
    programs |= _rock_programs(ctx)
    for program in programs.values():
        for sampler, unit in _UNITS.items():
            if sampler in program:
                program.__setitem__(sampler, unit)
        if "Frame" in program:
            block = program["Frame"]
            assert isinstance(block, moderngl.UniformBlock)
            block.binding = 0
    return programs


def _rock_programs(ctx: moderngl.Context) -> dict[str, moderngl.Program]:
    """Return the programs of rocks of all kinds, in pictures and in shadow maps."""
    table = shape_table()
    most = table.planes.shape[1]
    faces = dict(zip(ROCK_KINDS, (0, int(table.count[CUBE]), most), strict=True))
    # Half spaces that hold everything fill the table up.
    planes = table.planes.astype("f4")
    planes[~planes[..., :3].any(2), 3] = 1.0
    programs = {}
    for kind in ROCK_KINDS:
        round_one = faces[kind] == 0
        shape = () if round_one else (f"MOST {most}", f"FACES {faces[kind]}")
        before = ("half_sphere",) if round_one else ()
        stem = "half_sphere" if round_one else "hull"
        for suffix, truth in (("", ()), ("-truth", ("TRUTH",))):
            programs[kind + suffix] = ctx.program(
                shader("frame", "light", "given_light", "rock_vertex", defines=shape),
                shader("light", "paint", *before, f"{stem}_fragment", defines=(*shape, *truth)),
            )
        programs[f"{kind}-shadow"] = ctx.program(
            shader("frame", "rock_vertex", defines=("SHADOW", *shape)),
            shader(*before, f"{stem}_shadow_fragment", defines=shape),
        )
        if not round_one:
            for suffix in ("", "-truth", "-shadow"):
                uniform = programs[kind + suffix]["planes"]
                assert isinstance(uniform, moderngl.Uniform)
                uniform.write(planes.tobytes())
    return programs
