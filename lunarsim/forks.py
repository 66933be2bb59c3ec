"""Refuse to fly or to render in a forked process that would crash or hang.

GNU OpenMP, on which Numba runs parallel kernels, ends a process that was forked after its first
use. An OpenGL context and its thread do not survive a fork either.
"""

from __future__ import annotations

import os
import sys

_state = {"is_unsafe": False}


def watch_forks() -> None:
    """Register a check that runs in every child process right after a fork.

    If the child inherits OpenMP threads, `check` raises an error in it later.
    """
    os.register_at_fork(after_in_child=_mark_if_openmp_runs)


def mark_unsafe() -> None:
    """Note that this forked process inherits OpenMP or OpenGL state and cannot fly."""
    _state["is_unsafe"] = True


def check() -> None:
    """Raise an error in a process that was forked after a flight or a rendered image.

    Raises
    ------
    RuntimeError
        If the process is unsafe; the message states how to start processes instead.
    """
    if _state["is_unsafe"]:
        raise RuntimeError(
            "A process that is forked after a flight cannot use OpenMP or OpenGL. Start it with "
            'multiprocessing.get_context("spawn"), or environments with '
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
