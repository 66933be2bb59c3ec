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
        """Return the future result of a call."""
        with self._starting:
            if self._calls is None:
                self._calls = SimpleQueue()
                for _ in range(self._count):
                    Thread(target=_serve, args=(self._calls,), name=self._name, daemon=True).start()
        future: Future[R] = Future()
        self._calls.put((future, partial(function, *args, **kwargs)))
        return future

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
