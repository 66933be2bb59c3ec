"""Run compiled kernels on Python threads, each thread with a part of the loop.

Numba compiles a `parallel` kernel four times, once for each wrapper of its loop. A kernel that
takes its part of the loop as an argument is compiled once. Python threads run it concurrently,
because it releases the global interpreter lock.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import wait
from typing import Any

import numba

from lunarsim._daemon_threads import DaemonThreads
from lunarsim.errors import NoThreadError

# Minimum work for which starting threads pays off, microseconds.
MIN_THREADED_WORK_US = 256

# One thread less than Numba's limit, because the calling thread works too.
_threads = DaemonThreads(max(int(numba.config.NUMBA_NUM_THREADS) - 1, 1), "lunarsim-share")


class PartitionedKernel:
    """Compiled kernel whose outer loop is distributed over Python threads.

    Parameters
    ----------
    compiled
        Kernel whose first argument is a tuple (first index, step), followed by the arguments of the
        call. It runs the iterations first, first + step, ... of its outer loop, writes its results
        into array arguments, and returns nothing.
    """

    def __init__(self, compiled: Callable[..., Any]) -> None:
        self.compiled = compiled
        self.__doc__ = compiled.__doc__
        self.__name__ = compiled.__name__
        self._called = False

    def __call__(self, *args: Any) -> None:
        """Run the kernel on all threads; return when the last thread has finished.

        The first call compiles the kernel and runs on one thread.
        """
        # The first call compiles, so further threads would only wait for it.
        shares = numba.get_num_threads() if self._called else 1
        if shares == 1:
            self._run_alone(*args)
            return
        try:
            others = [_threads.submit(self.compiled, (n, shares), *args) for n in range(1, shares)]
        except NoThreadError:
            self._run_alone(*args)
            return
        try:
            self.compiled((0, shares), *args)
        finally:
            wait(others)
        for other in others:
            other.result()

    def run_loop(self, count: int, microseconds: float, *args: Any) -> None:
        """Run the kernel, on the calling thread only if its loop is short.

        The loop has `count` iterations of about `microseconds` each. Waking threads for a few rays
        takes longer than computing them; on a busy machine it takes a thousand times longer. A ray,
        or 1000 multiply-adds, takes 1 microsecond.
        """
        if count == 1 or count * microseconds < MIN_THREADED_WORK_US:
            self._run_alone(*args)
        else:
            self(*args)

    def _run_alone(self, *args: Any) -> None:
        """Run the kernel on the calling thread."""
        self.compiled((0, 1), *args)
        self._called = True
