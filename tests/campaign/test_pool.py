"""Work spread over processes."""

from __future__ import annotations

import gc
import multiprocessing
import time
import weakref

import pytest
from rich.console import Console

from lunarsim.campaign.pool import collect_results, iterate_results

QUIET = Console(quiet=True)


def square_late(x: int) -> int:
    # The first takes longest: results come out of order.
    time.sleep(0.2 if x == 0 else 0.0)
    return x * x


def third_interrupts(x: int) -> int:
    if x == 2:
        raise KeyboardInterrupt
    return -x


def first_interrupts(x: int) -> int:
    raise KeyboardInterrupt


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_are_in_the_order_of_the_tasks(jobs):
    assert collect_results(square_late, range(7), jobs, QUIET, "squares") == [
        x * x for x in range(7)
    ]


def test_what_is_done_before_an_interrupt_is_kept():
    assert collect_results(third_interrupts, range(5), 1, QUIET, "numbers") == [0, -1]
    with pytest.raises(KeyboardInterrupt):
        collect_results(first_interrupts, range(5), 1, QUIET, "numbers")


class Circle:
    def __init__(self) -> None:
        self.itself = self


CIRCLES: weakref.WeakSet[Circle] = weakref.WeakSet()


def leaves_a_circle(x: int) -> int:
    """Return how many circles earlier tasks have left in this process."""
    gc.disable()
    left = len(CIRCLES)
    CIRCLES.add(Circle())
    time.sleep(0.55)  # memory is freed after tasks of 0.5 s or longer
    return left


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_task_leaves_behind_is_freed(jobs):
    try:
        assert collect_results(leaves_a_circle, range(4), jobs, QUIET, "circles") == [0] * 4
    finally:
        gc.enable()


def sleeps(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def test_workers_end_with_the_work():
    """An interrupt leaves no process that goes on for what nobody takes any more."""
    work = iterate_results(sleeps, [0.0, 600.0, 600.0], 2)
    assert next(work) == (0, 0.0)
    workers = multiprocessing.active_children()
    assert workers
    work.close()
    # The pool's own thread may fetch an exit code before `join` does: ask again.
    until = time.monotonic() + 20.0
    while any(w.exitcode is None for w in workers) and time.monotonic() < until:
        time.sleep(0.05)
    assert all(w.exitcode is not None for w in workers)
