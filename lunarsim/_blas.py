"""Limit BLAS to one thread during a flight.

The matrices are small. Additional threads would wait for each other, and waiting threads occupy a
core that image processing and kernels need (a fifth of the wall-clock time of a flight with all
sensors). Results also must not depend on the number of threads.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import scipy.linalg  # noqa: F401  (loads its own BLAS, which the controller must find)
from threadpoolctl import ThreadpoolController


class _ThreadState(threading.local):
    """State of one thread: whether it is in a block of `one_blas_thread`."""

    is_limited = False


_thread_state = _ThreadState()


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit the linear algebra library (BLAS) to one thread in a block.

    Use it in a `with` block or as a decorator. The outermost block restores the setting. The
    setting belongs to the process: if several Python threads enter blocks at the same time, the
    first one sets it (see `threadpoolctl`).
    """
    if _thread_state.is_limited:
        yield
        return
    with _libraries().limit(limits=1):
        _thread_state.is_limited = True
        try:
            yield
        finally:
            _thread_state.is_limited = False
