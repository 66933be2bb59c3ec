"""Programs, meshes and textures of one context, and how values reach them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunarsim.sensors.rendering.context import shader
from lunarsim.sensors.rendering.relief_tiles import LEVELS, level_mesh
from lunarsim.terrain.shapes import shape_table

Array = NDArray[np.float64]


def float_texture(ctx: moderngl.Context, data: NDArray[Any]) -> moderngl.Texture:
    """Return an array (rows, cols, parts) as a float32 texture without filtering."""
    data = np.ascontiguousarray(data, np.float32)
    rows, cols, parts = data.shape
    texture = ctx.texture((cols, rows), parts, data.tobytes(), dtype="f4")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture


@lru_cache(maxsize=LEVELS)
def tile_mesh(ctx: moderngl.Context, level: int) -> tuple[moderngl.Buffer, moderngl.Buffer]:
    """Return the vertices and triangles of one level of detail; all terrains share them."""
    posts, triangles = level_mesh(level)
    return ctx.buffer(posts.tobytes()), ctx.buffer(triangles.tobytes())


@lru_cache(maxsize=2)
def build_programs(ctx: moderngl.Context, holes: tuple[str, ...]) -> dict[str, moderngl.Program]:
    """Return all programs; terrains of one context share them."""
    programs = {}
    table = shape_table()
    most = f"MOST {table.planes.shape[1]}"
    to_map = "PLACE(rel) map_position(rel)"
    programs["relief"] = ctx.program(
        shader("view", "relief_vertex", defines=("PLACE(rel) project(rel)", *holes)),
        shader("depth_fragment", defines=holes),
    )
    programs["rocks"] = ctx.program(
        shader("rock_vertex"), shader("view", "ray", "rock", "rock_fragment", defines=(most,))
    )
    for name, defines in (("shade", ()), ("shade-truth", ("TRUTH",))):
        programs[name] = ctx.program(
            shader("screen_vertex"),
            shader("view", "ray", "shadow", "light", "shade_fragment", defines=defines),
        )
    programs["relief-shadow"] = ctx.program(
        shader("shadow", "map_position", "relief_vertex", defines=(to_map, *holes)),
        shader("depth_fragment", defines=holes),
    )
    programs["rocks-shadow"] = ctx.program(
        shader("rock_vertex"), shader("rock", "rock_shadow_fragment", defines=(most,))
    )
    for name, defines in (("small-rocks", ("STONE",)), ("small-rocks-shadow", ())):
        programs[name] = ctx.program(
            shader("small_rock_vertex", defines=defines),
            shader("small_rock_fragment", defines=defines),
        )
    for name, program in programs.items():
        if name.startswith("rocks"):
            faces = np.zeros(32, np.int32)
            faces[: table.count.size] = table.count
            set_uniforms(program, {"faces": faces.tolist()})
            planes = program["planes"]
            assert isinstance(planes, moderngl.Uniform)
            planes.write(table.planes.astype("f4").tobytes())
    return programs


def set_uniforms(program: moderngl.Program, values: dict[str, Any]) -> None:
    """Give a program those values that it uses."""
    for name, value in values.items():
        if name in program:  # the compiler drops what a shader does not use
            program.__setitem__(name, value)


def columns(matrix: Array) -> tuple[float, ...]:
    """Return a matrix as OpenGL takes it, column by column."""
    return tuple(float(x) for x in matrix.T.ravel())
