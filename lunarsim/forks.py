"""Refuse to fly or to render in a forked process that would crash or hang.

GNU OpenMP, on which Numba runs parallel kernels, ends a process that was forked after its first
use. An OpenGL context and its thread do not survive a fork either.
"""

from __future__ import annotations

import os
import sys

_state = {"is_unsafe": False}


def watch_forks() -> None:
    """Check at every fork from now on whether the child inherits OpenMP threads."""
    os.register_at_fork(after_in_child=_mark_if_openmp_runs)


def mark_unsafe() -> None:
    """Note, in a forked child, that it inherits what does not survive a fork."""
    _state["is_unsafe"] = True


def check() -> None:
    """Raise an error in a process that was forked after a flight or an image.

    Raises
    ------
    RuntimeError
        With the line to type.
    """
    if _state["is_unsafe"]:
        raise RuntimeError(
            "This process was forked after a flight; OpenMP and OpenGL do not survive that. Start "
            'processes with multiprocessing.get_context("spawn"), environments with '
            'vector_kwargs={"context": "spawn"}.'
        )


def _mark_if_openmp_runs() -> None:
    numba = sys.modules.get("numba")
    if numba is None:
        return
    try:
        layer = numba.threading_layer()
    except (AttributeError, ValueError):  # Numba is being imported, or no layer is started
        return
    if layer == "omp":
        mark_unsafe()
