"""Execute flights on a Ray cluster, or on a local Ray instance."""

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

from lunarsim.campaign.engines.worker import limit_to_one_thread
from lunarsim.campaign.outcomes import KILLED, TIMEOUT, Finished, attempt, import_function
from lunarsim.campaign.plan import Group, Work
from lunarsim.campaign.provenance import code_digest, environment, environment_differences
from lunarsim.errors import InputError, missing_package

# Maximum time until an interrupt is noticed, s.
_POLL_INTERVAL_S = 0.2
# Maximum number of starts of a group whose worker or node is lost.
MAX_ATTEMPTS = 3
# Queued groups per core of the cluster.
_QUEUED_GROUPS_PER_CORE = 2
# Time limit for the connection to an address, s.
_CONNECT_TIMEOUT_S = 5.0


class RayEngine:
    """Executes each group of flights as a Ray task.

    Parameters
    ----------
    address
        Address of a running cluster, HOST:PORT; None: start Ray here with `jobs` cores.
    jobs
        Number of cores of a local instance.
    time_limit
        Wall-clock time after which a flight is ended, s; None: no limit.

    Attributes
    ----------
    name, polls_halt
        Attributes of the `Engine` interface.

    Raises
    ------
    InputError
        If Ray is not installed, or the address does not respond.
    """

    name = "ray"
    polls_halt = True

    def __init__(self, address: str | None, jobs: int, time_limit: float | None = None) -> None:
        if address is not None:
            _check_reachable(address)
        try:
            import ray  # noqa: PLC0415  (an extra)
        except ImportError:
            raise missing_package("--engine", "ray", "ray") from None
        self._ray: Any = ray
        self.address, self.jobs, self.time_limit = address, jobs, time_limit

    def fly(
        self, work: Work, groups: Iterable[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        """Fly groups of flights as Ray tasks; yield the results as groups end.

        The parameters are those of `Engine.fly`.

        After an interrupt Ray is not shut down here, which takes seconds: `exit_immediately` ends
        it.
        """
        ray = self._ray
        ours = not ray.is_initialized()
        if ours:
            self._connect()
        try:
            yield from self._run_groups(work, iter(groups), halt)
        finally:
            if ours and not halt():
                ray.shutdown()

    def _connect(self) -> None:
        more = {"num_cpus": self.jobs, "include_dashboard": False} if self.address is None else {}
        try:
            self._ray.init(address=self.address, log_to_driver=False, logging_level="error", **more)
        except Exception as error:  # Ray raises many types
            reason = str(error).strip().split("\n")[0]
            if self.address is None:
                raise InputError(
                    "--engine",
                    "ray",
                    f"cannot start Ray on this machine ({reason})",
                    show_value=False,
                ) from None
            raise InputError(
                "--address", self.address,
                "must be a running Ray cluster with the same versions of Ray and Python "
                f"({reason})",
            ) from None  # fmt: skip

    def _run_groups(
        self, work: Work, groups: Iterator[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        ray = self._ray
        task = ray.remote(num_cpus=1, max_retries=MAX_ATTEMPTS - 1)(fly_group)
        shared, expected_environment = ray.put(work), node_environment()
        window = _QUEUED_GROUPS_PER_CORE * max(1, int(ray.cluster_resources().get("CPU", 1)))
        pending: dict[Any, Group] = {}
        queue: list[Group] = []
        try:
            while not halt():
                while len(pending) < window:
                    group = queue.pop(0) if queue else next(groups, None)
                    if group is None:
                        break
                    pending[task.remote(shared, group, self.time_limit, expected_environment)] = (
                        group
                    )
                if not pending:
                    return
                for reference in ray.wait(list(pending), num_returns=1, timeout=_POLL_INTERVAL_S)[
                    0
                ]:
                    group = pending.pop(reference)
                    try:
                        yield from self.check_node(ray.get(reference))
                    except ray.exceptions.RayError as error:
                        yield from self._retry_lost(group, queue, str(error))
            yield from self._drain_messages(pending)
        finally:
            for reference in pending:
                with contextlib.suppress(Exception):
                    ray.cancel(reference, force=True)

    def _retry_lost(self, group: Group, queue: list[Group], message: str) -> Iterator[Finished]:
        """Handle a group whose process died, with the error `message` of Ray.

        An arm is a variant of the scenario. The arms of the group are added to the `queue` one by
        one. A group of a single arm is not repeated: its result with the outcome "killed" is
        yielded.
        """
        if len(group.arms) > 1:
            queue += [replace(group, arms=(arm,)) for arm in group.arms]
            return
        reason = message.strip().splitlines()[0]
        error = f"The process of the flight ended {MAX_ATTEMPTS} times ({reason})."
        yield Finished(
            group.flight,
            group.arms[0],
            KILLED,
            error=error,
            attempts=MAX_ATTEMPTS,
            finished=time.time(),
        )

    def _drain_messages(self, pending: dict[Any, Group]) -> Iterator[Finished]:
        ray = self._ray
        ready = ray.wait(list(pending), num_returns=len(pending), timeout=0)[0] if pending else []
        for reference in ready:
            with contextlib.suppress(ray.exceptions.RayError):
                yield from self.check_node(ray.get(reference))

    def check_node(self, received: list[Finished] | NodeMismatch) -> list[Finished]:
        """Return the flights `received` from a node; `InputError` if its software differs."""
        if isinstance(received, NodeMismatch):
            raise InputError(
                "--address", self.address,
                "must be a cluster with the same software on all nodes, but node "
                f"{received.worker} "
                f"differs: {received.differences}", "Install the same versions.", show_value=False,
            )  # fmt: skip
        return received


@dataclass(frozen=True)
class NodeMismatch:
    """Report of a cluster node whose code or packages differ from this machine.

    Attributes
    ----------
    worker, differences
        Host and process id of the node's worker; description of the differences.
    """

    worker: str
    differences: str


def fly_group(
    work: Work, group: Group, time_limit: float | None, expected_environment: Mapping[str, str]
) -> list[Finished] | NodeMismatch:
    """Fly a group on a worker of the cluster; return its finished flights.

    Parameters
    ----------
    work, group, time_limit
        Function and settings; group of flights; wall-clock limit of a flight, s.
    expected_environment
        Code and packages of this campaign. A node with others does not fly.
    """
    here, worker = node_environment(), f"{socket.gethostname()}:{os.getpid()}"
    different = environment_differences(expected_environment, here)
    if different:
        differences = [
            f"{n} {here.get(n, 'none')} (here {expected_environment.get(n, 'none')})"
            for n in different
        ]
        return NodeMismatch(worker, ", ".join(differences))
    function = import_function(work)
    limit_to_one_thread()
    memory: dict[Any, Any] = {}
    found = []
    for arm in group.arms:
        with _flight_time_limit(time_limit):
            done = attempt(function, work, group, arm, memory)
        if done.error.startswith(f"{__name__}.{_FlightTimeoutError.__name__}"):
            error = f"The flight exceeded the time limit of {time_limit:g} s."
            done = replace(done, outcome=TIMEOUT, error=error, traceback="")
        found.append(replace(done, worker=worker))
    return found


@cache
def node_environment() -> dict[str, str]:
    """Return the code digest and package versions of this process."""
    return {"lunarsim": f"code {code_digest()}"} | environment()


class _FlightTimeoutError(BaseException):
    """Exception raised inside a flight that exceeds its wall-clock time limit."""


def exit_immediately(status: int) -> NoReturn:
    """End this process and Ray's local processes at once, without Ray's slow shutdown.

    Running flights end with this process. The agents of a killed node would wait for a minute, so
    they are killed first.
    """
    for node in _children(os.getpid()):
        with contextlib.suppress(OSError):
            if Path(f"/proc/{node}/comm").read_text().strip() == "raylet":
                for agent in _children(node):
                    os.kill(agent, signal.SIGKILL)
    os._exit(status)


def _children(process: int) -> list[int]:
    """Return the process ids of child processes; empty where there is no /proc."""
    try:
        listed = Path(f"/proc/{process}/task/{process}/children").read_text()
    except OSError:
        return []
    return [int(number) for number in listed.split()]


@contextlib.contextmanager
def _flight_time_limit(seconds: float | None) -> Iterator[None]:
    """Raise `_FlightTimeoutError` in the enclosed code after a number of seconds.

    None is no limit.
    """
    if seconds is None:
        yield
        return

    def over(number: int, frame: FrameType | None) -> None:
        raise _FlightTimeoutError

    old = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)


def _check_reachable(address: str) -> None:
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise InputError("--address", address, "must be HOST:PORT of a running Ray cluster")
    try:
        socket.create_connection((host, int(port)), timeout=_CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise InputError(
            "--address", address, f"must be an address that responds ({error})"
        ) from None
