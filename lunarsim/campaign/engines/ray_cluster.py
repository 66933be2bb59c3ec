"""Flights on a Ray cluster, or on Ray here: its own scheduling, retries and object store."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from lunarsim.campaign.engines.worker import one_thread
from lunarsim.campaign.files import code_digest, differing, environment
from lunarsim.campaign.outcomes import KILLED, TIMEOUT, Finished, attempt, function_of
from lunarsim.campaign.plan import Group, Work
from lunarsim.errors import InputError

# How long an interrupt may go unseen, s.
_TICK = 0.2
# How often Ray begins a group whose worker or node is lost.
TRIES = 3
# Groups that wait at the cluster, for each of its cores.
_WINDOW = 2
# An address answers within, s.
_ANSWER = 5.0


class RayEngine:
    """Ray tasks, a group each.

    Parameters
    ----------
    address
        Of a running cluster, HOST:PORT; None: Ray is started here, with `jobs` cores.
    jobs
        Cores where it is started here.
    time_limit
        Wall-clock time after which a flight is ended, s; None: never.

    Attributes
    ----------
    name, asks_to_halt
        See `Engine`.

    Raises
    ------
    InputError
        If Ray is not installed, or the address does not answer.
    """

    name = "ray"
    asks_to_halt = True

    def __init__(self, address: str | None, jobs: int, time_limit: float | None = None) -> None:
        if address is not None:
            _check_answers(address)
        try:
            import ray  # noqa: PLC0415  (an extra)
        except ImportError:
            raise InputError(
                "--engine", "ray", 'local, or Ray installed: pip install "lunarsim[ray]"'
            ) from None
        self._ray: Any = ray
        self.address, self.jobs, self.time_limit = address, jobs, time_limit

    def fly(
        self, work: Work, groups: Iterable[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        """Yield flights as their groups end; see `Engine`.

        After an interrupt Ray is left to `leave_at_once`: nobody is to wait the seconds that it
        needs to take its leave.
        """
        ray = self._ray
        ours = not ray.is_initialized()
        if ours:
            self._join()
        try:
            yield from self._flown(work, iter(groups), halt)
        finally:
            if ours and not halt():
                ray.shutdown()

    def _join(self) -> None:
        more = {"num_cpus": self.jobs, "include_dashboard": False} if self.address is None else {}
        try:
            self._ray.init(address=self.address, log_to_driver=False, logging_level="error", **more)
        except Exception as error:  # Ray raises what it likes
            said = str(error).strip().split("\n")[0]
            if self.address is None:
                raise InputError("--engine", "ray", f"a Ray that starts here ({said})") from None
            raise InputError(
                "--address", self.address, f"a running Ray cluster of this version ({said})"
            ) from None

    def _flown(
        self, work: Work, groups: Iterator[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        ray = self._ray
        task = ray.remote(num_cpus=1, max_retries=TRIES - 1)(fly_group)
        shared, made_by = ray.put(work), this_node()
        window = _WINDOW * max(1, int(ray.cluster_resources().get("CPU", 1)))
        pending: dict[Any, Group] = {}
        again: list[Group] = []
        try:
            while not halt():
                while len(pending) < window:
                    group = again.pop(0) if again else next(groups, None)
                    if group is None:
                        break
                    pending[task.remote(shared, group, self.time_limit, made_by)] = group
                if not pending:
                    return
                for reference in ray.wait(list(pending), num_returns=1, timeout=_TICK)[0]:
                    group = pending.pop(reference)
                    try:
                        yield from self.check_node(ray.get(reference))
                    except ray.exceptions.RayError as error:
                        yield from self._lost(group, again, str(error))
            yield from self._heard_last(pending)
        finally:
            for reference in pending:
                with contextlib.suppress(Exception):
                    ray.cancel(reference, force=True)

    def _lost(self, group: Group, again: list[Group], said: str) -> Iterator[Finished]:
        """Fly the arms of a lost group apart; one that is lost by itself is recorded."""
        if len(group.arms) > 1:
            again += [replace(group, arms=(arm,)) for arm in group.arms]
            return
        error = f"its process ended {TRIES} times ({said.strip().splitlines()[0]})"
        yield Finished(
            group.flight, group.arms[0], KILLED, error=error, tries=TRIES, finished=time.time()
        )

    def _heard_last(self, pending: dict[Any, Group]) -> Iterator[Finished]:
        ray = self._ray
        ready = ray.wait(list(pending), num_returns=len(pending), timeout=0)[0] if pending else []
        for reference in ready:
            with contextlib.suppress(ray.exceptions.RayError):
                yield from self.check_node(ray.get(reference))

    def check_node(self, came: list[Finished] | OtherNode) -> list[Finished]:
        """Return the flights of a node; refuse one that gives other results."""
        if isinstance(came, OtherNode):
            raise InputError(
                "--address", self.address,
                f"nodes with code and packages of this machine: {came.who} has {came.has}",
            )  # fmt: skip
        return came


@dataclass(frozen=True)
class OtherNode:
    """A node that may give other results than this machine.

    Attributes
    ----------
    who, has
        Host and process; what differs, in words.
    """

    who: str
    has: str


def fly_group(
    work: Work, group: Group, time_limit: float | None, made_by: Mapping[str, str]
) -> list[Finished] | OtherNode:
    """Fly a group on a worker of the cluster; return what became of each flight.

    Parameters
    ----------
    work, group, time_limit
        What; the longest that a flight may take, s.
    made_by
        Code and packages that the rows will name as theirs: nothing is flown by others.
    """
    here, who = this_node(), f"{socket.gethostname()}:{os.getpid()}"
    other = differing(made_by, here)
    if other:
        told = [f"{n} {here.get(n, 'none')} (here {made_by.get(n, 'none')})" for n in other]
        return OtherNode(who, ", ".join(told))
    function = function_of(work)
    one_thread()
    memory: dict[Any, Any] = {}
    found = []
    for arm in group.arms:
        with _limited(time_limit):
            done = attempt(function, work, group, arm, memory)
        if done.error.startswith(f"{__name__}.{_TooLongError.__name__}"):
            error = f"it took longer than {time_limit:g} s"
            done = replace(done, outcome=TIMEOUT, error=error, traceback="")
        found.append(replace(done, worker=who))
    return found


@cache
def this_node() -> dict[str, str]:
    """Return code and packages of this process."""
    return {"lunarsim": f"code {code_digest()}"} | environment()


class _TooLongError(BaseException):
    """A flight took longer than its limit."""


def leave_at_once(status: int) -> NoReturn:
    """End this process and all that Ray started for it here, without Ray's seconds of farewell.

    What flies ends with this process. The agents of a node that was killed look for a minute for
    somebody to tell, so they go first.
    """
    for node in _children(os.getpid()):
        with contextlib.suppress(OSError):
            if Path(f"/proc/{node}/comm").read_text().strip() == "raylet":
                for agent in _children(node):
                    os.kill(agent, signal.SIGKILL)
    os._exit(status)


def _children(process: int) -> list[int]:
    """Return the numbers of a process's children; none where there is no /proc."""
    try:
        listed = Path(f"/proc/{process}/task/{process}/children").read_text()
    except OSError:
        return []
    return [int(number) for number in listed.split()]


@contextlib.contextmanager
def _limited(seconds: float | None) -> Iterator[None]:
    """Raise `_TooLongError` in what runs inside once the time is over."""
    if seconds is None:
        yield
        return

    def over(number: int, frame: FrameType | None) -> None:
        raise _TooLongError

    old = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)


def _check_answers(address: str) -> None:
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise InputError("--address", address, "HOST:PORT of a running Ray cluster")
    try:
        socket.create_connection((host, int(port)), timeout=_ANSWER).close()
    except (OSError, OverflowError) as error:
        raise InputError("--address", address, f"an address that answers ({error})") from None
