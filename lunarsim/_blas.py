"""One thread for the matrix products of a flight.

They are small: more threads wait for each other, and what waits spins on a core that the pictures
and the kernels need (a fifth of the wall clock of a flight with all eyes). And the bits must not
depend on how many there are.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import scipy.linalg  # noqa: F401  (brings its own BLAS, which must be known by then)
from threadpoolctl import ThreadpoolController

_lock = threading.Lock()
_inside = 0
_limits: list[Any] = []


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread, in a `with` block or as a decorator; as it was, after the last."""
    global _inside  # noqa: PLW0603  (the setting is one of the process)
    with _lock:
        if _inside == 0:
            _limits.append(_libraries().limit(limits=1))
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                _limits.pop().restore_original_limits()
