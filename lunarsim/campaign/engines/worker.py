"""Worker process of a campaign: flies the groups of flights that it receives."""

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

from lunarsim.campaign.outcomes import attempt, import_function
from lunarsim.campaign.plan import Work

# Messages of a worker: ready; a flight began; a flight ended; a group is done.
READY, BEGAN, ENDED, DONE = "ready", "began", "ended", "done"
_PR_SET_PDEATHSIG = 1


def run_worker(work: Work, connection: Connection, lifeline: Connection, parent: int) -> None:
    """Fly the groups of flights received from a connection until it closes.

    Parameters
    ----------
    work
        Function and settings that all flights share.
    connection
        Connection that receives groups and sends messages.
    lifeline
        Connection without messages; it closes when the parent ends.
    parent
        Process id of the parent.
    """
    _end_with_parent(parent, lifeline)
    # A keyboard interrupt reaches all processes; only the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    function = import_function(work)
    limit_to_one_thread()
    connection.send((READY, None))
    fresh = True
    while True:
        try:
            group = connection.recv()
        except EOFError:
            return
        memory: dict[Any, Any] = {}
        for arm in group.arms:
            connection.send((BEGAN, arm))
            connection.send((ENDED, attempt(function, work, group, arm, memory)))
        memory.clear()
        _collect_garbage(fresh)
        fresh = False
        connection.send((DONE, None))


def _collect_garbage(is_first_group: bool) -> None:
    """Free reference cycles that flights leave, about 70 MB each.

    Objects loaded by the first group are frozen, which makes later collections cheap.
    """
    gc.collect()
    if is_first_group:
        gc.freeze()


def limit_to_one_thread() -> None:
    """Limit a worker to one thread, because the processes share the cores."""
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    if "numpy" in sys.modules:
        import threadpoolctl  # noqa: PLC0415

        threadpoolctl.threadpool_limits(1)


def _end_with_parent(parent: int, lifeline: Connection) -> None:
    """Make this process end when its parent process, given by id, ends.

    `lifeline` is a connection that closes when the parent ends.
    """
    if sys.platform == "linux":
        # The operating system kills it at once, even within a long compiled kernel.
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)

    def watch() -> None:
        with contextlib.suppress(EOFError, OSError):
            lifeline.recv()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
