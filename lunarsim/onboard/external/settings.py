"""Settings that name external flight software: a library or a program."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from lunarsim.errors import InputError
from lunarsim.interface.structs import Struct
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.external.encode import checked_text, new_briefing
from lunarsim.onboard.external.fmu import FmuConnection
from lunarsim.onboard.external.library import LibraryConnection
from lunarsim.onboard.external.process import ProcessConnection, program_arguments
from lunarsim.onboard.external.recording import with_record
from lunarsim.parts.program_permission import check_program
from lunarsim.parts.quantity import check_bounds, quantity

_HOST = Path(__file__).with_name("host.py")


class Connection(Protocol):
    """Connection to external software of one role during one flight."""

    def step(self, given: Struct, answer: Struct) -> None:
        """Call the software with the input and output messages of its role."""
        ...

    def close(self) -> None:
        """End the software."""
        ...


def hosted(path: Path, role: str) -> list[str]:
    """Return the command that runs a shared library or an FMU in a process."""
    return [sys.executable, str(_HOST), str(path), role]


def load_software(path: Path, role: str, briefing: Struct) -> Connection:
    """Load one role of a shared library, or of an FMU (.fmu), into this process.

    Raises
    ------
    InputError
        If the file is unsuitable, or its initialisation fails.
    """
    load = FmuConnection if path.suffix == ".fmu" else LibraryConnection
    return load(path, role, briefing)


@dataclass(frozen=True)
class _Software:
    """Settings that libraries and programs share."""

    configuration: str = quantity(
        "", help="text that the software gets in its briefing, at most 1023 bytes"
    )
    deadline: float = quantity(
        5.0, "s", gt=0, le=3600, help="maximum wall-clock time of an answer; a later one ends the "
        "flight as failed",
    )  # fmt: skip

    def _check(self, name: str, path: Path | None) -> None:
        """Raise InputError unless the file `path` of the setting `name` may run."""
        check_bounds(self, "")
        if path is None:
            raise InputError(name, None, "is required", "Name a file.", show_value=False)
        checked_text("Briefing", "configuration", self.configuration, "configuration")
        check_program(name, path)


@dataclass(frozen=True)
class LibrarySoftware(_Software):
    """Settings of flight software in a shared library or an FMU.

    Attributes
    ----------
    path
        File of the library or FMU.
    configuration
        Text for the software.
    isolated
        Whether the library runs in another process.
    deadline
        Maximum wall-clock time of an answer of an isolated library, s.
    """

    path: Path | None = quantity(
        None, help="shared library (.so) or FMU (.fmu), relative to the scenario file; it must be "
        "allowed with --allow-program",
    )  # fmt: skip
    isolated: bool = quantity(
        True, help="whether the library runs in another process; otherwise it is faster, but "
        "if it crashes or hangs, lunarsim does too",
    )  # fmt: skip

    def __post_init__(self) -> None:
        self._check("path", self.path)

    def connect(self, role: str, briefing: Briefing) -> Connection:
        """Load the library for one flight; `role` is the part that it replaces.

        Raises
        ------
        InputError
            If the library is unsuitable, or its initialisation fails.
        """
        assert self.path is not None
        given = new_briefing(briefing, self.configuration)
        connection: Connection
        if self.isolated:
            try:
                connection = ProcessConnection(
                    hosted(self.path, role), role, given, deadline=self.deadline
                )
            except InputError as error:
                raise InputError("path", str(self.path), error.problem, error.remedy) from None
        else:
            connection = load_software(self.path, role, given)
        return with_record(connection, role, given)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class ProcessSoftware(_Software):
    """Settings of flight software in a program.

    Attributes
    ----------
    program, arguments
        File of the program, and its arguments.
    configuration
        Text for the software.
    deadline, start_time
        Maximum wall-clock time of an answer, and of start and initialisation, s.
    transport
        Kind of the socket.
    """

    program: Path | None = quantity(
        None, help="executable file or Python script (.py), relative to the scenario file; it must "
        "be allowed with --allow-program",
    )  # fmt: skip
    arguments: tuple[str, ...] = quantity((), help="arguments of the program")
    start_time: float = quantity(
        20.0, "s", gt=0, le=3600, help="maximum wall-clock time of start and initialisation"
    )
    transport: Literal["unix", "tcp"] = quantity(
        "unix", help="socket of the connection: Unix, or TCP on the loopback interface"
    )

    def __post_init__(self) -> None:
        self._check("program", self.program)

    def connect(self, role: str, briefing: Briefing) -> Connection:
        """Start the program for one flight; `role` is the part that it replaces.

        Raises
        ------
        InputError
            If the program cannot be started, or does not initialise itself in time.
        """
        assert self.program is not None
        given = new_briefing(briefing, self.configuration)
        connection = ProcessConnection(
            program_arguments(self.program, self.arguments), role, given,
            start_time=self.start_time, deadline=self.deadline, transport=self.transport,
        )  # fmt: skip
        return with_record(connection, role, given)  # type: ignore[no-any-return]
