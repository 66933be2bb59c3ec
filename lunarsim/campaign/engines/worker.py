"""A worker process: flies groups that it is sent, and ends with its parent, however that ends."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import signal
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any

from lunarsim.campaign.outcomes import attempt, function_of
from lunarsim.campaign.plan import Work

# What a worker says: it is there; a flight begins; a flight has ended; a group is done.
READY, BEGAN, ENDED, DONE = "ready", "began", "ended", "done"
_PR_SET_PDEATHSIG = 1


def serve(work: Work, orders: Connection, lifeline: Connection, parent: int) -> None:
    """Fly until the orders end.

    Parameters
    ----------
    work
        What flies.
    orders
        Groups come in, what becomes of them goes out.
    lifeline
        Nothing comes on it; it closes when the parent is gone.
    parent
        Process id of the parent.
    """
    _end_with(parent, lifeline)
    # An interrupt from the keyboard reaches all processes; the parent says what follows from it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    function = function_of(work)
    one_thread()
    orders.send((READY, None))
    fresh = True
    while True:
        try:
            group = orders.recv()
        except EOFError:
            return
        memory: dict[Any, Any] = {}
        for arm in group.arms:
            orders.send((BEGAN, arm))
            orders.send((ENDED, attempt(function, work, group, arm, memory)))
        memory.clear()
        _swept(fresh)
        fresh = False
        orders.send((DONE, None))


def _swept(first: bool) -> None:
    """Free what flights leave behind in circles: some 70 MB each, which nobody else would for long.

    What the first group has loaded stays, and is not looked through again: that makes it cheap.
    """
    gc.collect()
    if first:
        gc.freeze()


def one_thread() -> None:
    """Keep a worker to one thread: the processes share the cores."""
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    if "numpy" in sys.modules:
        import threadpoolctl  # noqa: PLC0415

        threadpoolctl.threadpool_limits(1)


def _end_with(parent: int, lifeline: Connection) -> None:
    """See to it that this process does not outlive its parent."""
    if sys.platform == "linux":
        # The kernel does it at once, even in the midst of a long kernel of ours.
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)

    def watch() -> None:
        with contextlib.suppress(EOFError, OSError):
            lifeline.recv()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
