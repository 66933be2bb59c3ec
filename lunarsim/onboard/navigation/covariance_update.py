"""A symmetric covariance less a product, in place and on several threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from lunarsim._jit import threads_for
from lunarsim.onboard.navigation._rock_filter_kernels import subtract_outer, subtract_product

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_BLOCK = 384
_ROWS = 64


def subtract_square(p: Array, w: Array) -> None:
    """Subtract w' w (n, n) from the symmetric p in place, w being (m, n).

    Block by block above the diagonal: the products then stay in the cache. Blocks are shared among
    threads, and are the same however many there are.
    """
    if len(w) == 1:
        with threads_for(4e-4 * len(p) ** 2):
            subtract_outer(p, w[0])
        return
    n = len(p)

    def subtract(start: int) -> None:
        stop = min(start + _BLOCK, n)
        p[start:stop, start:] -= w[:, start:stop].T @ w[:, start:]
        p[stop:, start:stop] = p[start:stop, stop:].T

    _share(subtract, range(0, n, _BLOCK))


def subtract_rows(p: Array, gain: Array, hp: Array, states: Index) -> None:
    """Subtract the gain (s, k) times H P (k, n) from rows `states` (s,) of the symmetric p (n, n).

    In place, and from its columns too. Blocks of rows are shared among threads, and are the same
    however many there are.
    """
    place = np.full(len(p), -1)
    place[states] = np.arange(len(states))
    product = np.empty((len(states), len(p)))

    def multiply(start: int) -> None:
        np.matmul(gain[start : start + _ROWS], hp, out=product[start : start + _ROWS])

    _share(multiply, range(0, len(states), _ROWS))
    with threads_for(1e-3 * len(states) * len(p)):
        subtract_product(p, product, states, place)


def _share(job: Callable[[int], None], starts: range) -> None:
    """Run a job for each start, on as many threads as kernels use."""
    threads = numba.get_num_threads()
    if threads == 1 or len(starts) == 1:
        for start in starts:
            job(start)
    else:
        list(_threads(threads).map(job, starts))


@lru_cache(maxsize=1)
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count)
