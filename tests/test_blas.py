"""BLAS keeps to one thread inside, and is afterwards as it was."""

from __future__ import annotations

import subprocess
import sys

import pytest

# In a process of its own: what other tests have set stays in theirs.
HEAD = """
import threading
from threadpoolctl import threadpool_info, threadpool_limits
from lunarsim._blas import one_blas_thread

def threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}
"""
NESTED = """
@one_blas_thread()
def inner():
    return threads()

with threadpool_limits(2, "blas"):
    with one_blas_thread():
        assert inner() == {1}
        assert threads() == {1}
    assert threads() == {2}
    try:
        with one_blas_thread():
            1 / 0
    except ZeroDivisionError:
        assert threads() == {2}
"""
THREADS = """
told = []

def other():
    with one_blas_thread():
        told.append(threads())

for _ in range(2):
    thread = threading.Thread(target=other)
    thread.start()
    thread.join()
    with threadpool_limits(2, "blas"):
        with one_blas_thread():
            told.append(threads())
        assert threads() == {2}
assert told == [{1}] * 4
"""


@pytest.mark.parametrize(
    "code",
    [
        pytest.param(NESTED, id="nested, and after an error"),
        pytest.param(THREADS, id="one Python thread after the other"),
    ],
)
def test_blas_has_one_thread_inside_and_is_afterwards_as_it_was(code):
    told = subprocess.run(
        [sys.executable, "-c", HEAD + code], capture_output=True, text=True, check=False
    )
    assert told.returncode == 0, told.stderr
