"""Distribute tasks over processes; results do not depend on their number."""

from __future__ import annotations

import gc
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import takewhile
from typing import TypeVar

import numba  # noqa: F401  (must be loaded for `limit_to_one_thread` to limit its threads)
from rich.console import Console

from lunarsim.campaign.engines.picklable import check_picklable
from lunarsim.campaign.engines.worker import limit_to_one_thread
from lunarsim.console import plain_progress

T = TypeVar("T")
R = TypeVar("R")

# Minimum time between two collections of garbage, s: in a process with many objects, a collection
# takes up to 0.5 s, which is longer than a short task.
_COLLECTION_INTERVAL_S = 0.5
_last_collection = -_COLLECTION_INTERVAL_S


class TaskPool:
    """Processes that run batches of tasks and stay alive within a `with` block.

    Parameters
    ----------
    jobs
        Number of processes, which start with the first batch; 1: this process.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._executor: ProcessPoolExecutor | None = None

    def __enter__(self) -> TaskPool:
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        executor = self._executor
        if executor is None:
            return
        if error is None:
            executor.shutdown()
            return
        # Without this, running tasks would delay the end of this process.
        workers = list((executor._processes or {}).values())
        executor.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.terminate()

    def iterate_results(
        self, function: Callable[[T], R], tasks: Sequence[T]
    ) -> Iterator[tuple[int, R]]:
        """Call a function on each task of a batch; yield index and result as they end.

        The parameters are those of the function `iterate_results`.
        """
        if self._jobs == 1:
            for index, task in enumerate(tasks):
                yield index, _run_task(function, task)
            return
        check_picklable("tasks", (function, tasks[:1]))
        executor = self._started()
        waiting: dict[Future[R], int] = {}
        queue = iter(enumerate(tasks))

        def fill() -> None:
            for index, task in queue:
                waiting[executor.submit(_run_task, function, task)] = index
                if len(waiting) >= 2 * self._jobs:
                    break

        fill()
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED)[0]:
                yield waiting.pop(future), future.result()
            fill()

    def _started(self) -> ProcessPoolExecutor:
        """Return the processes; start them if necessary."""
        if self._executor is None:
            # OpenGL contexts and Numba's thread pools do not survive a fork.
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(
                self._jobs, mp_context=context, initializer=limit_to_one_thread
            )
        return self._executor


def iterate_results(
    function: Callable[[T], R], tasks: Sequence[T], jobs: int
) -> Iterator[tuple[int, R]]:
    """Call a function on each task in processes; yield index and result as they end.

    Few tasks are queued at a time, so an interrupt takes effect soon.

    Parameters
    ----------
    function
        Function at the top level of a module, so that processes can import it.
    tasks
        Arguments of the function.
    jobs
        Number of processes; 1: this process.
    """
    with TaskPool(jobs) as pool:
        yield from pool.iterate_results(function, tasks)


def _run_task(function: Callable[[T], R], task: T) -> R:
    """Call a function on a task, then free unreachable memory; a flight leaves 0.4 GB.

    After short tasks, memory is freed at intervals.
    """
    global _last_collection  # noqa: PLW0603
    try:
        return function(task)
    finally:
        if time.monotonic() - _last_collection > _COLLECTION_INTERVAL_S:
            gc.collect()
            _last_collection = time.monotonic()


def collect_results(
    function: Callable[[T], R], tasks: Sequence[T], jobs: int, console: Console, task_name: str
) -> list[R]:
    """Call a function on each task in processes with a progress bar; return results.

    The results are in the order of the tasks.

    After an interrupt, return the results from the first task up to the first gap. If there are
    none, raise the interrupt again.

    Parameters
    ----------
    function, tasks, jobs
        Function, its arguments and the number of processes, as for `iterate_results`.
    console
        Console of the progress bar.
    task_name
        Name of the tasks, in the plural.
    """
    done: dict[int, R] = {}
    with plain_progress(console) as progress:
        bar = progress.add_task(task_name, total=len(tasks))
        try:
            for index, result in iterate_results(function, tasks, jobs):
                done[index] = result
                progress.advance(bar)
        except KeyboardInterrupt:
            if 0 not in done:
                raise
            console.print(f"Interrupted after {len(done)} of {len(tasks)} {task_name}.")
    return [done[i] for i in takewhile(done.__contains__, range(len(tasks)))]
