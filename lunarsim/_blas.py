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

import scipy.linalg  # noqa: F401  (brings its own BLAS, which must be known by then)
from threadpoolctl import ThreadpoolController


class _Inside(threading.local):
    """Whether a thread is inside."""

    now = False


_inside = _Inside()


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread, in a `with` block or as a decorator; as it was, after the outermost.

    The setting is one of the process: of Python threads that ask at once the first has its way, see
    `threadpoolctl`.
    """
    if _inside.now:
        yield
        return
    with _libraries().limit(limits=1):
        _inside.now = True
        try:
            yield
        finally:
            _inside.now = False
