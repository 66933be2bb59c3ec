"""Execute flights in processes of this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from typing import Any

from lunarsim.campaign.engines.worker import BEGAN, DONE, ENDED, READY, run_worker
from lunarsim.campaign.outcomes import KILLED, TIMEOUT, Finished
from lunarsim.campaign.plan import Group, Work

# Maximum time until an interrupt is noticed, s.
_POLL_INTERVAL_S = 0.1
# Maximum number of starts of a flight whose process dies.
MAX_ATTEMPTS = 3


class WorkerStartError(RuntimeError):
    """Workers ended before they were ready; their stderr shows the reason."""


class _Worker:
    """Worker process of a campaign and the flight that it is flying."""

    def __init__(self, work: Work) -> None:
        # OpenGL contexts and Numba's thread pools do not survive a fork.
        context = multiprocessing.get_context("spawn")
        self.orders, theirs = context.Pipe()
        theirs_line, self.lifeline = context.Pipe(duplex=False)
        self.process = context.Process(
            target=run_worker, args=(work, theirs, theirs_line, os.getpid()), daemon=True
        )
        with block_interrupts():
            self.process.start()
        theirs.close()
        theirs_line.close()
        self.ready = False
        self.group: Group | None = None
        self.left: list[int] = []
        self.arm: int | None = None
        self.began = 0.0

    def assign(self, group: Group) -> None:
        self.group, self.left, self.arm = group, list(group.arms), None
        self.orders.send(group)

    def end(self) -> int | None:
        """Kill the process if it is still running; return its exit code."""
        self.process.kill()
        self.process.join()
        self.orders.close()
        self.lifeline.close()
        return self.process.exitcode


class LocalEngine:
    """Executes flights in processes of this machine, which end with this process.

    Parameters
    ----------
    jobs
        Number of processes.
    time_limit
        Wall-clock time after which a flight is ended, s; None: no limit.

    Attributes
    ----------
    name, polls_halt
        Attributes of the `Engine` interface.
    """

    name = "local"
    polls_halt = True

    def __init__(self, jobs: int, time_limit: float | None = None) -> None:
        self.jobs, self.time_limit = jobs, time_limit
        self._workers: list[_Worker] = []
        self._requeued: deque[Group] = deque()
        self._tries: Counter[tuple[int, int]] = Counter()
        self._failed_starts = 0

    def fly(
        self, work: Work, groups: Iterable[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        """Fly groups of flights in processes; yield the result of each as it finishes.

        The parameters are those of `Engine.fly`. A flight whose process dies is started up to
        `MAX_ATTEMPTS` times.

        Raises
        ------
        WorkerStartError
            If `MAX_ATTEMPTS` workers in a row end before they are ready.
        """
        source = iter(groups)
        try:
            while True:
                self._assign(work, source)
                busy = [w for w in self._workers if w.group is not None]
                if not busy:
                    return
                for connection in wait([w.orders for w in busy], self._wait_timeout(busy)):
                    yield from self._receive(next(w for w in busy if w.orders is connection))
                if halt():
                    yield from self._drain_messages()
                    return
                yield from self._end_overdue()
        finally:
            for worker in self._workers:
                worker.end()
            self._workers.clear()

    def _assign(self, work: Work, source: Iterator[Group | None]) -> None:
        """Give every free worker a group of flights from `source`.

        New workers are started while there are groups and fewer than `jobs` workers.
        """
        free = deque(w for w in self._workers if w.group is None)
        while free or len(self._workers) < self.jobs:
            group = self._requeued.popleft() if self._requeued else next(source, None)
            if group is None:
                return
            if not free:
                self._workers.append(_Worker(work))
                free.append(self._workers[-1])
            # A worker that died idle cannot be detected here; `_receive` handles its end later.
            with contextlib.suppress(OSError):
                free.popleft().assign(group)

    def _wait_timeout(self, busy: list[_Worker]) -> float:
        if self.time_limit is None:
            return _POLL_INTERVAL_S
        now = time.monotonic()
        left = [w.began + self.time_limit - now for w in busy if w.arm is not None]
        return min([_POLL_INTERVAL_S, *(max(v, 0.0) for v in left)])

    def _receive(self, worker: _Worker) -> Iterator[Finished]:
        """Handle one message of a worker or its death; yield the flights that ended."""
        assert worker.group is not None
        try:
            what, value = worker.orders.recv()
        except Exception:  # the process ended, within a message or between two
            yield from self._handle_death(worker)
            return
        if what == READY:
            worker.ready, self._failed_starts = True, 0
        elif what == BEGAN:
            worker.arm, worker.began = value, time.monotonic()
        elif what == ENDED:
            worker.left.remove(value.arm)
            worker.arm = None
            yield replace(value, attempts=1 + self._tries.pop((value.flight, value.arm), 0))
        elif what == DONE:
            worker.group = None

    def _handle_death(self, worker: _Worker) -> Iterator[Finished]:
        """Put the unfinished flights of a dead worker back in the queue.

        A flight whose process has died `MAX_ATTEMPTS` times is not repeated: its result with the
        outcome "killed" is yielded. If as many workers in a row ended before they were ready, a
        `WorkerStartError` is raised.
        """
        code = self._remove_worker(worker)
        group = worker.group
        assert group is not None
        if not worker.ready:
            self._failed_starts += 1
            if self._failed_starts >= MAX_ATTEMPTS:
                raise WorkerStartError(
                    f"{MAX_ATTEMPTS} workers in a row ended before they were ready (exit code "
                    f"{code}). Their messages are above. A script that flies with several jobs "
                    'needs the line `if __name__ == "__main__":` before it calls lunarsim.'
                )
        elif worker.left:
            arm = worker.left[0] if worker.arm is None else worker.arm
            self._tries[group.flight, arm] += 1
            tries = self._tries[group.flight, arm]
            if tries >= MAX_ATTEMPTS:
                worker.left.remove(arm)
                error = f"The process of the flight ended {_describe_exit(code)}, {tries} times."
                yield self._failed_flight(worker, arm, KILLED, error, tries)
        self._requeue(worker)

    def _end_overdue(self) -> Iterator[Finished]:
        """End flights that exceed the time limit, and yield their results."""
        if self.time_limit is None:
            return
        now = time.monotonic()
        for worker in [w for w in self._workers if w.arm is not None]:
            if now - worker.began < self.time_limit or worker.orders.poll():
                continue
            arm = worker.arm
            assert arm is not None
            self._remove_worker(worker)
            worker.left.remove(arm)
            error = f"The flight exceeded the time limit of {self.time_limit:g} s."
            yield self._failed_flight(worker, arm, TIMEOUT, error, 1)
            self._requeue(worker)

    def _failed_flight(
        self, worker: _Worker, arm: int, outcome: str, error: str, tries: int
    ) -> Finished:
        assert worker.group is not None
        return Finished(
            worker.group.flight, arm, outcome, error=error, attempts=tries, finished=time.time(),
            seconds=time.monotonic() - worker.began, worker=str(worker.process.pid),
        )  # fmt: skip

    def _requeue(self, worker: _Worker) -> None:
        if worker.group is not None and worker.left:
            self._requeued.appendleft(replace(worker.group, arms=tuple(worker.left)))

    def _remove_worker(self, worker: _Worker) -> int | None:
        self._workers.remove(worker)
        return worker.end()

    def _drain_messages(self) -> Iterator[Finished]:
        """End all workers; yield finished flights that have not been received yet."""
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            worker.process.join()
            while worker.group is not None and worker.orders.poll():
                message = _try_receive(worker.orders)
                if message is None:
                    break
                if message[0] == ENDED:
                    yield message[1]


@contextlib.contextmanager
def block_interrupts() -> Iterator[None]:
    """Block keyboard interrupts in processes that start within the context.

    This process receives its interrupts after the context.

    The keyboard sends SIGINT to all processes, and one that is still loading would die of it with
    a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _try_receive(connection: Connection) -> Any:
    try:
        return connection.recv()
    except Exception:
        return None


def _describe_exit(code: int | None) -> str:
    """Describe the exit code of a process as words, for instance "by signal SIGKILL"."""
    if code is None or code >= 0:
        return f"with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
    more = ", possibly out of memory" if code == -signal.SIGKILL else ""
    return f"by signal {name}{more}"
