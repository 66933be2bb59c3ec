"""Forked workers: which of them cannot fly, told before they die.

Kernels that Numba spreads over threads run on GNU OpenMP, which ends a process that was forked from
one where it has run already. So a worker of `AsyncVectorEnv` dies without a word if its parent has
flown before, unless workers are spawned.
"""

from __future__ import annotations

import os

import numba

_state = {"unsafe": False}


def _layer() -> str:
    """Return the threading layer that has been started, or nothing."""
    try:
        return str(numba.threading_layer())
    except ValueError:
        return ""


def _note() -> None:
    _state["unsafe"] = _layer() == "omp"


os.register_at_fork(after_in_child=_note)


def check() -> None:
    """Refuse to fly in a process that would be ended by it.

    Raises
    ------
    RuntimeError
        With the line to type.
    """
    if _state["unsafe"]:
        raise RuntimeError(
            "this process was forked from one that has flown already, and GNU OpenMP would end it: "
            'start workers afresh, gymnasium.make_vec(ID, num_envs=8, vectorization_mode="async", '
            'vector_kwargs={"context": "spawn"})'
        )
