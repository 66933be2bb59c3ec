"""Threads that serve calls until the process ends.

A `concurrent.futures.ThreadPoolExecutor` refuses calls as soon as the main thread has ended,
although other threads may still fly or render then.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class NoThreadError(RuntimeError):
    """Threads can no longer be started."""


class DaemonThreads:
    """Run calls on threads that start at the first call.

    Parameters
    ----------
    count
        Number of threads.
    name
        Name of the threads.
    """

    _calls: SimpleQueue[Any] | None

    def __init__(self, count: int, name: str) -> None:
        self._count, self._name = count, name
        self._forget_threads()
        # A forked child inherits none of the threads.
        os.register_at_fork(after_in_child=self._forget_threads)

    def submit(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Return the future result of a call.

        Raises
        ------
        NoThreadError
            If no thread starts at the first call: from Python 3.12 on none does once the main
            thread has ended, and a process may not have more than its limit.
        """
        with self._starting:
            calls = self._calls or self._started()
        future: Future[R] = Future()
        calls.put((future, partial(function, *args, **kwargs)))
        return future

    def _started(self) -> SimpleQueue[Any]:
        """Start the threads, or as many as start; return the queue of their calls."""
        calls: SimpleQueue[Any] = SimpleQueue()
        for started in range(self._count):
            try:
                Thread(target=_serve, args=(calls,), name=self._name, daemon=True).start()
            except RuntimeError as error:
                if started:
                    break
                raise NoThreadError(
                    f"no thread starts ({error}). If the main thread has ended, let it wait for "
                    "the others: thread.join()"
                ) from None
        self._calls = calls
        return calls

    def _forget_threads(self) -> None:
        self._calls = None
        self._starting = Lock()


def _serve(calls: SimpleQueue[Any]) -> None:
    while True:
        future, call = calls.get()
        try:
            future.set_result(call())
        except BaseException as error:  # it belongs to the caller
            future.set_exception(error)
        del future, call  # an idle thread keeps nothing alive
