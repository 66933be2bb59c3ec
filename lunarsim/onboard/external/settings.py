"""Settings that name external flight software: a library or a program."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
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
class _Software(ABC):
    """Settings that libraries and programs share.

    Attributes
    ----------
    path
        File of the software.
    configuration
        Text for the software.
    deadline
        Maximum wall-clock time of an answer, s.
    """

    path: Path | None = quantity(
        None, help="shared library (.so), FMU (.fmu), executable file or Python script (.py), "
        "relative to the scenario file; it must be allowed with --allow-program",
    )  # fmt: skip
    configuration: str = quantity(
        "", help="text that the software gets in its briefing, at most 1023 bytes"
    )
    deadline: float = quantity(
        5.0, "s", gt=0, le=3600, help="maximum wall-clock time of an answer; a later one ends the "
        "flight as failed",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_bounds(self, "")
        checked_text("Briefing", "configuration", self.configuration, "configuration")
        if any("\0" in one for one in getattr(self, "arguments", ())):
            raise InputError("arguments", None, "must not contain null characters")
        self._allowed_path()

    def _allowed_path(self) -> Path:
        """Return the file, or raise InputError unless it may run."""
        if self.path is None:
            raise InputError("path", None, "is required", "Name a file.", show_value=False)
        check_program("path", self.path)
        return self.path.resolve()

    @abstractmethod
    def _open(self, path: Path, role: str, briefing: Struct) -> Connection:
        """Start the software."""

    def connect(self, role: str, briefing: Briefing) -> Connection:
        """Start the software for one flight; `role` is the part that it replaces.

        Raises
        ------
        InputError
            If the software is unsuitable, not allowed, or does not initialise itself in time.
        """
        given, path = new_briefing(briefing, self.configuration), self._allowed_path()
        try:
            connection = self._open(path, role, given)
        except InputError as error:
            raise InputError("path", str(path), error.problem, error.remedy) from None
        return with_record(connection, role, given)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class LibrarySoftware(_Software):
    """Settings of flight software in a shared library or an FMU.

    Attributes
    ----------
    isolated
        Whether the library runs in another process.
    """

    isolated: bool = quantity(
        True, help="whether the library runs in another process; otherwise it is faster, but "
        "if it crashes or hangs, lunarsim does too, and deadline_s has no effect",
    )  # fmt: skip

    def _open(self, path: Path, role: str, briefing: Struct) -> Connection:
        if not self.isolated:
            return load_software(path, role, briefing)
        return ProcessConnection(hosted(path, role), role, briefing, deadline=self.deadline)


@dataclass(frozen=True)
class ProcessSoftware(_Software):
    """Settings of flight software in a program.

    Attributes
    ----------
    arguments
        Arguments of the program.
    start_time
        Maximum wall-clock time of start and initialisation, s.
    transport
        Kind of the socket.
    """

    arguments: tuple[str, ...] = quantity((), help="arguments of the program")
    start_time: float = quantity(
        20.0, "s", gt=0, le=3600, help="maximum wall-clock time of start and initialisation"
    )
    transport: Literal["unix", "tcp"] = quantity(
        "unix", help="socket of the connection: Unix, or TCP on the loopback interface"
    )

    def _open(self, path: Path, role: str, briefing: Struct) -> Connection:
        return ProcessConnection(
            program_arguments(path, self.arguments), role, briefing, start_time=self.start_time,
            deadline=self.deadline, transport=self.transport,
        )  # fmt: skip
