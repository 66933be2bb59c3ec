"""Subtract matrix products from a symmetric covariance, in place and in parallel."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numba
import numpy as np

from lunarsim._jit import threads_for
from lunarsim.onboard.navigation._rock_filter_kernels import (
    mirror_lower,
    subtract_product_from_rows,
    subtract_square_from_rows,
)
from lunarsim.typing import Array, IntArray

_BLOCK = 384
_ROWS = 64
# Up to this number of rows in w, row by row is faster than a matrix product.
_FEW = 6


def subtract_square(p: Array, w: Array) -> None:
    """Subtract w' w of a Kalman update from the symmetric covariance p, in place.

    `p` is (n, n) and `w` (m, n). For small m this is done row by row, otherwise in blocks above the
    diagonal that fit the cache. The blocks are distributed over threads; the result does not depend
    on the number of threads.
    """
    n = len(p)
    if len(w) <= _FEW:
        subtract_rows(p, w, np.arange(n))
        return

    def subtract(start: int) -> None:
        stop = min(start + _BLOCK, n)
        p[start:stop, start:] -= w[:, start:stop].T @ w[:, start:]
        p[stop:, start:stop] = p[start:stop, stop:].T

    _run_in_threads(subtract, range(0, n, _BLOCK))


def subtract_rows(p: Array, w: Array, states: IntArray) -> None:
    """Subtract w' w of a Kalman update from some rows of the covariance p, in place.

    `states` (s,) are the indices of the rows; `p` (n, n) is symmetric; `w` is (m, n). The block of
    `states` stays symmetric; their columns in other rows are not changed. The rows are distributed
    over threads; the result does not depend on the number of threads.
    """
    if len(w) <= _FEW:
        with threads_for(4e-4 * len(w) * len(states) * len(p)):
            subtract_square_from_rows(p, w, states)
        return
    own = np.ascontiguousarray(w[:, states].T)

    def subtract(start: int) -> None:
        block = slice(start, start + _ROWS)
        subtract_product_from_rows(p, own[block] @ w, states[block])

    _run_in_threads(subtract, range(0, len(states), _ROWS))
    with threads_for(1e-3 * len(states) ** 2):
        mirror_lower(p, states)


def _run_in_threads(job: Callable[[int], None], starts: range) -> None:
    """Run a function for each start index, distributed over the kernels' threads."""
    threads = numba.get_num_threads()
    if threads == 1 or len(starts) == 1:
        for start in starts:
            job(start)
    else:
        list(_threads(threads).map(job, starts))


@lru_cache(maxsize=1)
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count)
