"""One OpenGL context per process, used only by one rendering thread.

A context is current in one thread only. OpenGL calls from any other thread fail or draw garbage
without an error. All functions that use OpenGL therefore run on the rendering thread.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextvars import copy_context
from functools import lru_cache, partial, wraps
from importlib.resources import files
from typing import ParamSpec, TypeVar

import moderngl
import numba

from lunarsim import forks
from lunarsim._daemon_threads import DaemonThreads
from lunarsim.errors import RenderingError

P = ParamSpec("P")
R = TypeVar("R")

_MISSING_OPENGL = (
    "Rendering needs OpenGL 3.3 through EGL. On Debian or Ubuntu: "
    "apt-get install libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"
)
_WRONG_VECTOR_WIDTH = (
    "Rendering with 128-bit or 512-bit vectors can crash in Mesa (seen with 22.3). "
    "Set LP_NATIVE_VECTOR_WIDTH=256."
)
_here = threading.local()
_render_thread = DaemonThreads(1, "lunarsim-render")


def on_render_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to run on the rendering thread; callers wait for its result."""

    def run(threads: int, *args: P.args, **kwargs: P.kwargs) -> R:
        _here.is_render_thread = True
        numba.set_num_threads(threads)
        # Garbage collection in other threads only queues OpenGL objects; free them here.
        gl_context().gc()
        return function(*args, **kwargs)

    @wraps(function)
    def submit(*args: P.args, **kwargs: P.kwargs) -> R:
        if getattr(_here, "is_render_thread", False):
            return function(*args, **kwargs)
        forks.check()
        call = partial(run, numba.get_num_threads(), *args, **kwargs)
        return _render_thread.submit(copy_context().run, call).result()

    return submit


@lru_cache(maxsize=1)
def gl_context() -> moderngl.Context:
    """Return the OpenGL context of this process, on the rendering thread only.

    Raises
    ------
    RenderingError
        If EGL or OpenGL is missing, or llvmpipe uses vectors of 128 or 512 bits. The message
        contains the remedy.
    """
    if not getattr(_here, "is_render_thread", False):
        raise RuntimeError("OpenGL runs on one thread only: decorate the caller on_render_thread.")
    try:
        context = moderngl.create_context(standalone=True, backend="egl", require=330)  # type: ignore[arg-type]
    except Exception as error:  # moderngl raises plain Exception subclasses of many kinds
        raise RenderingError(f"{_MISSING_OPENGL} ({error})") from error
    renderer = context.info["GL_RENDERER"]
    if renderer.startswith("llvmpipe") and any(f"{n} bits" in renderer for n in (128, 512)):
        raise RenderingError(_WRONG_VECTOR_WIDTH)
    context.gc_mode = "context_gc"
    os.register_at_fork(after_in_child=forks.mark_unsafe)
    return context


def shader(*names: str, defines: tuple[str, ...] = ()) -> str:
    """Return the GLSL source of a shader: version, definitions, and the named files.

    `names` are shader files without suffix, `defines` are lines such as "BLOCK 16".
    """
    folder = files(__package__) / "shaders"
    parts = ["#version 330", *(f"#define {line}" for line in defines)]
    parts += [(folder / f"{name}.glsl").read_text(encoding="utf-8") for name in names]
    return "\n".join(parts)
