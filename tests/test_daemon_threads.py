"""Threads that serve calls until the process ends."""

from __future__ import annotations

import gc
import sys
import time
import weakref
from threading import Thread, get_ident

import pytest

from lunarsim._daemon_threads import DaemonThreads


class _Mesh:
    """Stands for a large argument."""


def test_idle_threads_keep_no_arguments_or_results_alive():
    threads = DaemonThreads(1, "test")
    mesh = _Mesh()
    died = weakref.ref(mesh)
    assert threads.submit(lambda m: m, mesh).result() is mesh
    del mesh
    for _ in range(100):  # the thread forgets a call just after it has given the result
        gc.collect()
        if died() is None:
            break
        time.sleep(0.01)
    assert died() is None


def test_an_exception_is_the_callers_and_the_thread_serves_on():
    threads = DaemonThreads(1, "test")
    with pytest.raises(SystemExit):
        threads.submit(sys.exit).result()
    assert threads.submit(divmod, 7, 2).result() == (3, 1)


def test_a_first_call_that_comes_too_late_says_so_and_a_later_one_may_succeed(monkeypatch):
    def start(thread):
        raise RuntimeError("can't create new thread at interpreter shutdown")

    threads = DaemonThreads(1, "test")
    with monkeypatch.context() as patched:
        patched.setattr(Thread, "start", start)
        with pytest.raises(RuntimeError, match=r"main thread.*thread\.join\(\)"):
            threads.submit(divmod, 7, 2)
    assert threads.submit(divmod, 7, 2).result() == (3, 1)


def test_fewer_threads_than_asked_for_serve_all_calls(monkeypatch):
    """A process that has as many threads as it may have starts no other."""
    start, started = Thread.start, []

    def limited(thread):
        if started:
            raise RuntimeError("can't start new thread")
        started.append(thread)
        start(thread)

    monkeypatch.setattr(Thread, "start", limited)
    threads = DaemonThreads(4, "test")
    assert [one.result() for one in [threads.submit(abs, -n) for n in range(8)]] == list(range(8))
    assert len(started) == 1


def test_first_calls_from_many_threads_start_the_threads_once():
    served = []
    threads = DaemonThreads(1, "test")
    callers = [Thread(target=lambda: served.append(threads.submit(get_ident).result()))
               for _ in range(20)]  # fmt: skip
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert len(served) == 20
    assert len(set(served)) == 1
