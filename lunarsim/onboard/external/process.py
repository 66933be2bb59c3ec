"""Connection to flight software in another process."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim._daemon_threads import DaemonThreads
from lunarsim.errors import InputError
from lunarsim.interface.definitions import VERSION
from lunarsim.interface.protobuf import SizeError, from_protobuf, new_message, to_protobuf
from lunarsim.interface.structs import Struct
from lunarsim.interface.wire import (
    ADDRESS_VARIABLE,
    TOKEN_VARIABLE,
    Channel,
    SharedArrays,
    WireError,
)
from lunarsim.onboard.external.failure import SoftwareFailure

# Time that a program has to end after its connection is closed, s.
_END_TIME_S = 1.0
# Maximum length of the description of an error in a flight record.
_MAX_ERROR_CHARACTERS = 500
# Folder of sockets and shared memory, where the system has one in memory.
_MEMORY_FOLDER = Path("/dev/shm")


def program_arguments(program: Path, arguments: Sequence[str] = ()) -> list[str]:
    """Return the command that runs a program; a file ``.py`` runs with this Python."""
    start = [sys.executable, str(program)] if program.suffix == ".py" else [str(program)]
    return [*start, *arguments]


_STARTER = DaemonThreads(1, "lunarsim-programs")


class ProcessConnection:
    """Flight software of one role and one flight in a process.

    Parameters
    ----------
    command
        Program and its arguments.
    role
        Name of the role.
    briefing
        Briefing of the software.
    start_time, deadline
        Maximum durations of start and initialisation, and of each call, s.
    transport
        "unix" or "tcp" (loopback).

    Attributes
    ----------
    process
        Process of the program.

    Raises
    ------
    InputError
        If the program cannot be started, or does not complete its initialisation.
    """

    def __init__(
        self, command: Sequence[str], role: str, briefing: Struct, *, start_time: float = 20.0,
        deadline: float = 5.0, transport: str = "unix",
    ) -> None:  # fmt: skip
        self.role, self._deadline, self._program = role, deadline, command[0]
        if not os.access(command[0], os.X_OK):
            raise InputError("path", command[0], "must be an executable file")
        self._request, self._reply = new_message("Request"), new_message("Reply")
        parent = _MEMORY_FOLDER if os.access(_MEMORY_FOLDER, os.W_OK) else None
        folder = Path(tempfile.mkdtemp(prefix=f"lunarsim-{os.getpid()}-", dir=parent))
        cleaner = contextlib.ExitStack()
        # Also called when a flight is abandoned, or the interpreter ends.
        self._finalizer = weakref.finalize(self, cleaner.close)
        cleaner.callback(shutil.rmtree, folder, ignore_errors=True)
        self._memory = SharedArrays(folder / "arrays", is_owner=True)
        cleaner.callback(self._memory.close)
        try:
            self._start(command, folder, transport, cleaner, time.monotonic() + start_time)
            self._initialise(briefing, time.monotonic() + start_time)
            # Both sides have opened the memory: nothing is left if lunarsim is killed.
            shutil.rmtree(folder, ignore_errors=True)
        except SoftwareFailure as error:
            self.close()
            problem = f"must start and initialise itself: {error.detail}"
            if error.detail.startswith("must "):
                problem = error.detail  # an error of the path or of the configuration
            raise InputError("path", self._program, problem.rstrip(".")) from None
        except BaseException:
            self.close()
            raise

    def _start(
        self, command: Sequence[str], folder: Path, transport: str,
        cleaner: contextlib.ExitStack, deadline: float,
    ) -> None:  # fmt: skip
        """Start the program and accept its connection, at the latest at `deadline` (s)."""
        with contextlib.ExitStack() as listening:
            if transport == "unix":
                listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                listening.callback(listener.close)
                listener.bind(str(folder / "socket"))
                address = f"unix:{folder / 'socket'}"
            else:
                listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
                listening.callback(listener.close)
                listener.bind(("127.0.0.1", 0))
                address = f"tcp:127.0.0.1:{listener.getsockname()[1]}"
            listener.listen(1)
            token = secrets.token_hex(16)
            environment = os.environ | {ADDRESS_VARIABLE: address, TOKEN_VARIABLE: token}
            # The kernel kills the program when the thread that started it ends, so also when
            # lunarsim is killed. That thread must live as long as lunarsim.
            wrapper = shutil.which("setpriv")
            prefix = [wrapper, "--pdeathsig", "KILL", "--"] if wrapper else []
            try:
                self.process = _STARTER.submit(
                    subprocess.Popen, [*prefix, *command], stdin=subprocess.DEVNULL, stdout=2,
                    env=environment, start_new_session=True,
                ).result()  # fmt: skip
            except OSError as error:
                raise InputError(
                    "path", self._program, f"must be an executable file ({error.strerror})"
                ) from None
            cleaner.callback(_stop, self.process)
            self._channel = Channel(self._accept(listener, deadline))
            cleaner.callback(self._channel.close)
        self._receive(deadline)
        if self._reply.interface_version != VERSION:
            raise InputError(
                "path", self._program,
                f"must have interface version {VERSION}, not {self._reply.interface_version}",
            )  # fmt: skip
        if not secrets.compare_digest(self._reply.token.encode(), token.encode()):
            raise self._failure("protocol", f"the first reply lacks the value of {TOKEN_VARIABLE}")

    def _accept(self, listener: socket.socket, deadline: float) -> socket.socket:
        """Return the connection of the program."""
        listener.settimeout(0.02)
        while True:
            try:
                return listener.accept()[0]
            except TimeoutError:
                if self.process.poll() is not None:
                    raise self._death() from None
                if time.monotonic() > deadline:
                    raise self._failure("timeout", "the program did not connect in time") from None

    def _initialise(self, briefing: Struct, deadline: float) -> None:
        """Send the briefing and wait for the answer."""
        self._request.interface_version, self._request.role = VERSION, self.role
        self._request.shared_memory = str(self._memory.path)
        to_protobuf(briefing, self._request.briefing, self._memory)
        self._request.shared_memory_size = self._memory.size
        self._exchange(deadline)

    def step(self, given: Struct, answer: Struct) -> None:
        """Call the software with input and output of the role.

        Raises
        ------
        SoftwareFailure
            If the software ends, does not answer in time, reports an error, or its answer does not
            follow the interface.
        """
        self._request.Clear()
        self._memory.clear()
        message = getattr(self._request, f"{self.role}_input")
        to_protobuf(given, message, self._memory)
        self._request.shared_memory_size = self._memory.size
        self._exchange(time.monotonic() + self._deadline)
        name = f"{self.role}_output"
        if not self._reply.HasField(name):
            raise self._failure("protocol", f"the reply has no {name}")
        try:
            from_protobuf(getattr(self._reply, name), answer, self._memory)
        except (SizeError, WireError) as error:
            raise self._failure("protocol", str(error)) from None
        for f in given.message.fields:
            if f.written:
                array, block = given.arrays[f.name], getattr(message, f.name)
                written = self._memory.view(block.offset, block.count, array.dtype)
                np.copyto(array, written.reshape(array.shape))

    def _exchange(self, deadline: float) -> None:
        """Send the request and receive the reply, at the latest at `deadline` (s)."""
        try:
            self._channel.send(self._request, deadline)
        except WireError as error:
            raise self._broken(error) from None
        except TimeoutError:
            raise self._failure("timeout", "the program does not read its messages") from None
        self._receive(deadline)
        if self._reply.error:
            raise self._failure("error", self._reply.error[:_MAX_ERROR_CHARACTERS])

    def _receive(self, deadline: float) -> None:
        self._reply.Clear()
        try:
            self._channel.receive(self._reply, deadline)
        except TimeoutError:
            if self.process.poll() is not None:
                raise self._death() from None
            raise self._failure("timeout", "no answer within the deadline") from None
        except WireError as error:
            raise self._broken(error) from None

    def _broken(self, error: WireError) -> SoftwareFailure:
        """Return the failure of a program whose connection has an error."""
        return self._death() if "closed" in str(error) else self._failure("protocol", str(error))

    def _failure(self, reason: Any, detail: str) -> SoftwareFailure:
        return SoftwareFailure(self.role, reason, detail)

    def _death(self) -> SoftwareFailure:
        """Return the failure of a program that has ended or closed its connection."""
        try:
            code = self.process.wait(_END_TIME_S)
        except subprocess.TimeoutExpired:
            return self._failure("protocol", "the program has closed the connection")
        how = f"exit code {code}"
        if code < 0:
            names = {one.value: one.name for one in signal.Signals}
            how = f"signal {names.get(-code, -code)}"
        return self._failure("died", f"the program ended with {how}")

    def close(self) -> None:
        """Close the connection and end the program; further calls do nothing."""
        self._finalizer()


def _stop(process: subprocess.Popen[bytes]) -> None:
    """Wait a moment for the end of a process, then kill it and its children."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_END_TIME_S)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
