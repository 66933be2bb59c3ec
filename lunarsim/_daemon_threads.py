"""A thread pool that accepts calls until the process ends.

A `concurrent.futures.ThreadPoolExecutor` refuses calls as soon as the main thread has ended,
although other threads may still be flying or rendering.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, ParamSpec, TypeVar

from lunarsim.errors import NoThreadError

P = ParamSpec("P")
R = TypeVar("R")


class DaemonThreads:
    """Thread pool for function calls; its daemon threads start at the first call.

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
        """Queue a function call for a thread and return its future result.

        Raises
        ------
        NoThreadError
            If no thread starts at the first call. Since Python 3.12, no thread can start after the
            main thread has ended, and the operating system limits the number of threads.
        """
        with self._starting:
            calls = self._calls or self._start_threads()
        future: Future[R] = Future()
        calls.put((future, partial(function, *args, **kwargs)))
        return future

    def _start_threads(self) -> SimpleQueue[Any]:
        """Start the threads, or as many as can start; return their queue of calls."""
        calls: SimpleQueue[Any] = SimpleQueue()
        for started in range(self._count):
            try:
                Thread(target=_serve, args=(calls,), name=self._name, daemon=True).start()
            except RuntimeError as error:
                if started:
                    break
                raise NoThreadError(
                    f"Python cannot start a thread ({error}). If the main thread has ended, let it "
                    "wait for the other threads: thread.join()"
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
        except BaseException as error:  # the caller of `result()` gets it
            future.set_exception(error)
        del future, call  # an idle thread must not keep objects alive
