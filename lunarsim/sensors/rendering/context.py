"""One OpenGL context a process, made when a picture is first asked for."""

from __future__ import annotations

import os
from functools import lru_cache
from importlib.resources import files

import moderngl

from lunarsim.errors import RenderingError

_INSTALL = (
    "rendering needs OpenGL 3.3 through EGL; on Debian or Ubuntu: "
    "apt-get install libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"
)


@lru_cache(maxsize=1)
def _context_of(process: int) -> moderngl.Context:
    try:
        context = moderngl.create_context(standalone=True, backend="egl", require=330)  # type: ignore[arg-type]
    except Exception as error:  # moderngl raises plain Exception subclasses of many kinds
        raise RenderingError(f"{_INSTALL} ({error})") from error
    # Objects of collected renderers are freed at once; the default would leak them.
    context.gc_mode = "auto"
    return context


def gl_context() -> moderngl.Context:
    """Return the context of this process.

    It lives as long as the process. A context does not survive a fork: start processes by "spawn"
    or "forkserver".

    Raises
    ------
    RenderingError
        Where EGL or OpenGL is missing; it says what to install.
    """
    return _context_of(os.getpid())


def shader(*names: str, defines: tuple[str, ...] = ()) -> str:
    """Return GLSL source: version, definitions, and the named files of the package."""
    folder = files(__package__) / "shaders"
    parts = ["#version 330", *(f"#define {line}" for line in defines)]
    parts += [(folder / f"{name}.glsl").read_text(encoding="utf-8") for name in names]
    return "\n".join(parts)
