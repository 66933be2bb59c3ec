"""Kernels done in shares over threads, and kernels that only kernels call."""

from __future__ import annotations

import multiprocessing
import time

import numba
import numpy as np
import pytest

from lunarsim._jit import kernel
from lunarsim._work_partition import PartitionedKernel
from lunarsim.errors import NoThreadError


@kernel(shared=True)
def _squares(share, values, out):
    """Write the squares of values (n,)."""
    for i in range(share[0], values.size, share[1]):
        out[i] += values[i] * values[i]


@kernel()
def _half(x):
    """Return half of it."""
    return 0.5 * x


@kernel()
def halves(x):
    """Return half of what is half of it."""
    return _half(_half(x))


def _squared(values):
    out = np.zeros_like(values)
    _squares(values, out)
    return out


@pytest.fixture
def threads():
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


def test_every_turn_is_done_once_with_any_number_of_threads(threads):
    values = np.arange(1001.0)
    for count in range(1, numba.config.NUMBA_NUM_THREADS + 1):
        threads(count)
        assert np.array_equal(_squared(values), values**2)


def test_the_caller_does_all_turns_where_no_thread_starts(threads, monkeypatch):
    def late(*_):
        raise NoThreadError("no thread starts")

    threads(min(2, numba.config.NUMBA_NUM_THREADS))
    shares = []
    spy = PartitionedKernel(shares.append)
    spy()
    monkeypatch.setattr("lunarsim._daemon_threads.DaemonThreads.submit", late)
    spy()
    assert shares == [(0, 1), (0, 1)]


def test_shares_are_handed_out_as_many_as_there_are_threads(threads):
    seen = []

    def spy(share, fail):
        time.sleep(0.05 if share[0] else 0.0)  # the caller is the first to end
        seen.append(share)
        if fail == share[0]:
            raise ValueError("a share failed")

    threads(most := numba.config.NUMBA_NUM_THREADS)
    shared = PartitionedKernel(spy)
    shared(-1)
    assert seen == [(0, 1)]  # the first call compiles, alone
    seen.clear()
    shared(-1)
    assert sorted(seen) == [(n, most) for n in range(most)]
    for fail in range(most):  # the caller's own or another's
        seen.clear()
        with pytest.raises(ValueError, match="a share failed"):
            shared(fail)
        assert len(seen) == most  # the others have had their turn, none runs on


def test_a_short_loop_is_done_by_the_caller_alone(threads):
    threads(most := numba.config.NUMBA_NUM_THREADS)
    shares = []
    spy = PartitionedKernel(shares.append)
    for count, microseconds, own in (
        (1000, 1.0, 1),  # the first call compiles, alone
        (1, 1e6, 1), (1000, 0.25, 1), (1000, 0.26, most), (2, 1e6, most),
    ):  # fmt: skip
        shares.clear()
        spy.run_loop(count, microseconds)
        assert sorted(shares) == [(n, own) for n in range(own)]


def _child(queue):
    queue.put(float(_squared(np.arange(100.0)).sum()))


def test_a_forked_child_starts_threads_of_its_own():
    _squared(np.arange(100.0))
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_child, args=(queue,))
    child.start()
    try:
        assert queue.get(timeout=60.0) == float((np.arange(100.0) ** 2).sum())
    finally:
        child.kill()
        child.join()


def test_an_inner_kernel_refuses_a_call_from_python():
    assert halves(8.0) == 2.0
    with pytest.raises(TypeError, match="_half: only kernels can call this"):
        _half(8.0)
