"""Threads for compiled kernels that do a share of their work at a time.

A kernel that Numba spreads over threads itself is compiled four times over, once for each wrapper
about its loop. One that is handed a share is compiled once, and Python threads run it side by side:
it holds no lock while it runs.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import wait
from typing import Any

import numba

from lunarsim._daemon_threads import DaemonThreads, NoThreadError

# The caller's own thread does a share too.
_threads = DaemonThreads(max(int(numba.config.NUMBA_NUM_THREADS) - 1, 1), "lunarsim-share")


class Shared:
    """Runs a compiled kernel in shares, as many as Numba is allowed threads.

    Parameters
    ----------
    compiled
        Takes (which share, of how many), then the arguments of the call; of its outer loop it does
        every so-manieth turn, beginning with its own. It writes into arrays that it is given and
        returns nothing.
    """

    def __init__(self, compiled: Callable[..., Any]) -> None:
        self.compiled = compiled
        self.__doc__ = compiled.__doc__
        self.__name__ = compiled.__name__
        self._called = False

    def __call__(self, *args: Any) -> None:
        """Do all shares, and return when the last is done."""
        # The first call compiles; others would only wait for it.
        shares = numba.get_num_threads() if self._called else 1
        if shares == 1:
            self.compiled((0, 1), *args)
            self._called = True
            return
        try:
            others = [_threads.submit(self.compiled, (n, shares), *args) for n in range(1, shares)]
        except NoThreadError:
            self.compiled((0, 1), *args)
            return
        try:
            self.compiled((0, shares), *args)
        finally:
            wait(others)
        for other in others:
            other.result()
