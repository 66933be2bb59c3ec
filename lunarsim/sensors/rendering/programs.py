"""Shader programs, meshes and textures of a context, and their inputs."""

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
from lunarsim.sensors.rendering.shading_model import ShadingModel


def float_texture(ctx: moderngl.Context, data: NDArray[Any]) -> moderngl.Texture:
    """Create a float32 texture without filtering from an array (rows, cols, channels).

    Rows a power of two apart conflict in a processor's cache; such an array is padded by a few
    columns.
    """
    data = np.ascontiguousarray(data, np.float32)
    if data.strides[0] % 1024 == 0:
        data = np.pad(data, ((0, 0), (0, 16), (0, 0)), mode="edge")
    rows, cols, parts = data.shape
    texture = ctx.texture((cols, rows), parts, data.tobytes(), dtype="f4")
    disable_filtering(texture)
    return texture


def disable_filtering(texture: moderngl.Texture) -> None:
    """Set a texture to be read without filtering and clamped at its edges."""
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.repeat_x = texture.repeat_y = False


@lru_cache(maxsize=LEVELS)
def tile_mesh(ctx: moderngl.Context, level: int) -> tuple[moderngl.Buffer, moderngl.Buffer]:
    """Return the OpenGL buffers of a tile's mesh at a level of detail.

    The first contains vertices (column, row), the second triangles (vertex indices).
    """
    posts, triangles = level_mesh(level)
    return ctx.buffer(posts.tobytes()), ctx.buffer(triangles.tobytes())


# Texture units, and the names of their samplers in the shaders.
CORNERS, SHADOW, DEPTHS, ROCKS, BOUNDS, GLOW, MOTTLES, ALBEDO_MAP = range(8)
_UNITS = {
    "corners": CORNERS,
    "shadow": SHADOW,
    "depths": DEPTHS,
    "rocks": ROCKS,
    "bounds": BOUNDS,
    "glow": GLOW,
    "mottles": MOTTLES,
    "albedo_map": ALBEDO_MAP,
}

# Side of the blocks of the shadow map whose minimum and maximum depth are computed, texels.
BLOCK = 16

# One program per kind of rock: a driver that processes many pixels at once would run the code of
# all kinds for each of them.
ROCK_KINDS = ("half-sphere", "cube", "hull")


def shading_program_name(*, coarse: bool, leaks: bool, truth: bool) -> str:
    """Return the name of the shader program that shades the relief.

    Parameters
    ----------
    coarse
        Whether the relief was drawn at reduced resolution.
    leaks
        Whether light may leak through narrow ridges in the shadow map.
    truth
        Whether range, normal and rock index are also output.
    """
    return "shade" + "-coarse" * coarse + "-leaks" * leaks + "-truth" * truth


@lru_cache(maxsize=2)
def geometry_programs(ctx: moderngl.Context, holes: tuple[str, ...]) -> dict[str, moderngl.Program]:
    """Compile the shader programs that draw depth and shadow maps, by name.

    `holes` contains the definition "HOLES" if the relief has missing elevations.
    """
    block = (f"BLOCK {BLOCK}",)
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
        "bounds": ctx.program(shader("whole_vertex"), shader("bounds_fragment", defines=block)),
        "spread": ctx.program(shader("whole_vertex"), shader("spread_fragment")),
    }
    for kind in ROCK_KINDS:
        shape, before, stem = _rock_shader_parts(kind)
        programs[f"{kind}-shadow"] = ctx.program(
            shader("frame", "rock_vertex", defines=("SHADOW", *shape)),
            shader(*before, f"{stem}_shadow_fragment", defines=shape),
        )
    return _bind_inputs(programs)


@lru_cache(maxsize=16)
def shading_programs(ctx: moderngl.Context, model: ShadingModel) -> dict[str, moderngl.Program]:
    """Compile the shader programs that render images under one shading model, by name."""
    lit, own = model.sources(), model.defines
    before = ("frame", *lit[:1], "given_light")
    programs = {}
    for suffix, truth in (("", ()), ("-truth", ("TRUTH",))):
        for coarse, leaks in product((False, True), repeat=2):
            kind = (("COARSE",) if coarse else ()) + (("LEAKS",) if leaks else ())
            programs[shading_program_name(coarse=coarse, leaks=leaks, truth=bool(truth))] = (
                ctx.program(
                    shader(*before, "screen_vertex", defines=own),
                    shader(*lit, "paint", "shade_fragment", defines=(*truth, *kind, *own)),
                )
            )
        programs[f"small-rocks{suffix}"] = ctx.program(
            shader(*before, *lit[1:], "small_rock_vertex", defines=(*truth, *own)),
            shader("paint", "small_rock_fragment", defines=truth),
        )
        for rock in ROCK_KINDS:
            shape, first, stem = _rock_shader_parts(rock)
            programs[rock + suffix] = ctx.program(
                shader(*before, "rock_vertex", defines=(*shape, *own)),
                shader(*lit, "paint", *first, f"{stem}_fragment", defines=(*shape, *truth, *own)),
            )
    return _bind_inputs(programs)


def _rock_shader_parts(kind: str) -> tuple[tuple[str, ...], tuple[str, ...], str]:
    """Return what the shader of a kind of rock consists of: three values.

    They are the preprocessor definitions, the names of source files to include, and the stem of the
    main source file. `kind` is an element of `ROCK_KINDS`.
    """
    if kind == "half-sphere":
        return (), ("half_sphere",), "half_sphere"
    table = shape_table()
    max_faces = table.planes.shape[1]
    faces = int(table.count[CUBE]) if kind == "cube" else max_faces
    return (f"MOST {max_faces}", f"FACES {faces}"), (), "hull"


def _bind_inputs(programs: dict[str, moderngl.Program]) -> dict[str, moderngl.Program]:
    """Connect programs to textures, uniform block and rock shapes; return them."""
    table = shape_table()
    # Unused faces of the table become half spaces that contain everything.
    planes = table.planes.astype("f4")
    planes[~planes[..., :3].any(2), 3] = 1.0
    for program in programs.values():
        for sampler, unit in _UNITS.items():
            if sampler in program:
                program.__setitem__(sampler, unit)
        if "Frame" in program:
            block = program["Frame"]
            assert isinstance(block, moderngl.UniformBlock)
            block.binding = 0
        if "planes" in program:
            uniform = program["planes"]
            assert isinstance(uniform, moderngl.Uniform)
            uniform.write(planes.tobytes())
    return programs
