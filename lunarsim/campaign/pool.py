"""Work spread over processes, with results that do not depend on how many there are."""

from __future__ import annotations

import gc
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import takewhile
from typing import TypeVar

import numba  # noqa: F401  (loaded, so that its threads are held too)
from rich.console import Console

from lunarsim.campaign.engines.picklable import check_picklable
from lunarsim.campaign.engines.worker import one_thread
from lunarsim.console import plain_progress

T = TypeVar("T")
R = TypeVar("R")


def outcomes(function: Callable[[T], R], tasks: Sequence[T], jobs: int) -> Iterator[tuple[int, R]]:
    """Yield the index of each task and what `function` makes of it, as they come.

    Few tasks wait at a time, so an interrupt ends soon; what was yielded before is good.

    Parameters
    ----------
    function
        Of the top level of a module, so that processes find it.
    tasks
        Its arguments.
    jobs
        Processes; 1: this one.
    """
    if jobs == 1:
        for index, task in enumerate(tasks):
            yield index, _done(function, task)
        return
    check_picklable("tasks", (function, tasks[:1]))
    # OpenGL contexts and Numba's thread pools do not survive a fork.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=one_thread)
    try:
        waiting: dict[Future[R], int] = {}
        queue = iter(enumerate(tasks))

        def fill() -> None:
            for index, task in queue:
                waiting[pool.submit(_done, function, task)] = index
                if len(waiting) >= 2 * jobs:
                    break

        fill()
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED)[0]:
                yield waiting.pop(future), future.result()
            fill()
        pool.shutdown()
    except BaseException:
        # What is under way would be waited for at the end of this process.
        workers = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.terminate()
        raise


def _done(function: Callable[[T], R], task: T) -> R:
    """Do a task and free what it leaves in circles: flights leave 0.4 GB, which else waits long."""
    try:
        return function(task)
    finally:
        gc.collect()


def gathered(
    function: Callable[[T], R], tasks: Sequence[T], jobs: int, console: Console, what: str
) -> list[R]:
    """Return what `function` makes of the tasks, in their order, behind a progress bar.

    An interrupt ends the work: what is done by then, from the first task on without a gap, is
    returned; with nothing done the interrupt goes on.

    Parameters
    ----------
    function, tasks, jobs
        As for `outcomes`.
    console
        Where the bar is drawn.
    what
        Name of the tasks, in the plural.
    """
    done: dict[int, R] = {}
    with plain_progress(console) as progress:
        bar = progress.add_task(what, total=len(tasks))
        try:
            for index, result in outcomes(function, tasks, jobs):
                done[index] = result
                progress.advance(bar)
        except KeyboardInterrupt:
            if 0 not in done:
                raise
            console.print(f"interrupted after {len(done)} of {len(tasks)} {what}")
    return [done[i] for i in takewhile(done.__contains__, range(len(tasks)))]
