"""BLAS keeps to one thread inside, and is afterwards as it was."""

from __future__ import annotations

import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from lunarsim._blas import one_blas_thread


def threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


if threads() == {1}:
    pytest.skip("BLAS has one thread here", allow_module_level=True)
ALL = threads()


def test_it_is_as_it_was_after_the_last_of_nested_uses_and_after_errors():
    @one_blas_thread()
    def inner():
        return threads()

    with one_blas_thread():
        assert inner() == {1}
        assert threads() == {1}
    assert threads() == ALL
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        _ = 1 / 0
    assert threads() == ALL


def test_a_thread_that_has_been_inside_leaves_the_setting_to_others():
    told = []

    def other():
        with one_blas_thread():
            told.append(threads())

    for _ in range(2):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        with threadpool_limits(max(ALL), "blas"), one_blas_thread():
            told.append(threads())
        assert threads() == ALL
    assert told == [{1}] * 4
