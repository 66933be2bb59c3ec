"""Record the calls of external software, and repeat them without a simulation.

A record holds the briefing and the input and answer of each call: for each message its length
(unsigned, 64 bits, little-endian) and its bytes, and the same for the arrays of variable size. The
first message is a `Request` with role and briefing; then a `Request` and a `Reply` for each call.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.interface.definitions import ROLES, VERSION
from lunarsim.interface.protobuf import from_protobuf, new_message, to_protobuf
from lunarsim.interface.structs import Struct

_LENGTH = struct.Struct("<Q")
_MAX_PART_BYTES = 2**30
_ALIGNMENT = 64
_folder: ContextVar[Path | None] = ContextVar("folder", default=None)


class _Bytes:
    """Arrays of variable size of one message, in a sequence of bytes."""

    def __init__(self, data: bytes = b"") -> None:
        self.data = bytearray(data)

    def place(self, array: NDArray[Any]) -> int:
        """Append an array; return its offset."""
        self.data += bytes(-len(self.data) % _ALIGNMENT)
        start = len(self.data)
        self.data += array.tobytes()
        return start

    def view(self, offset: int, count: int, dtype: Any) -> NDArray[Any]:
        """Return a copy of an array (count,)."""
        end = offset + count * np.dtype(dtype).itemsize
        if end > len(self.data):
            raise ValueError("an array does not lie in the record")
        return np.frombuffer(self.data[offset:end], dtype)


@contextmanager
def recorded_in(folder: Path | None) -> Iterator[None]:
    """Record the calls of software that is started within a `with` statement.

    Each role has a file ROLE.messages in `folder`; a second one of a role has ROLE-2.messages.
    None: no record.
    """
    token = _folder.set(folder)
    try:
        yield
    finally:
        _folder.reset(token)


class RecordedConnection:
    """Connection that writes a record of its calls.

    Parameters
    ----------
    connection
        Connection to the software.
    role
        Name of the role.
    briefing
        Briefing of the software.
    folder
        Folder of the record.
    """

    def __init__(self, connection: Any, role: str, briefing: Struct, folder: Path) -> None:
        self._connection, self._role = connection, role
        folder.mkdir(parents=True, exist_ok=True)
        path, number = folder / f"{role}.messages", 1
        while path.exists():
            number += 1
            path = folder / f"{role}-{number}.messages"
        self._file: BinaryIO = path.open("xb")
        request, arrays = new_message("Request"), _Bytes()
        request.interface_version, request.role = VERSION, role
        to_protobuf(briefing, request.briefing, arrays)
        self._write(request, arrays)

    def _write(self, message: Any, arrays: _Bytes) -> None:
        for data in (message.SerializeToString(deterministic=True), bytes(arrays.data)):
            self._file.write(_LENGTH.pack(len(data)) + data)

    def step(self, given: Struct, answer: Struct) -> None:
        """Call the software, and record input and answer."""
        request, arrays = new_message("Request"), _Bytes()
        to_protobuf(given, getattr(request, f"{self._role}_input"), arrays)
        self._connection.step(given, answer)
        self._write(request, arrays)
        self._write(*answer_message(self._role, given, answer))

    def close(self) -> None:
        """End the software and close the file."""
        self._connection.close()
        self._file.close()


def answer_message(role: str, given: Struct, answer: Struct) -> tuple[Any, _Bytes]:
    """Return the answer to a call as a message with its arrays.

    The arrays include those of the input that the software writes.
    """
    reply, arrays = new_message("Reply"), _Bytes()
    to_protobuf(answer, getattr(reply, f"{role}_output"), arrays)
    for f in given.message.fields:
        if f.written:
            arrays.place(given.arrays[f.name])
    return reply, arrays


def with_record(connection: Any, role: str, briefing: Struct) -> Any:
    """Return a connection, recorded if `recorded_in` is active."""
    folder = _folder.get()
    return connection if folder is None else RecordedConnection(connection, role, briefing, folder)


class RecordedCalls(NamedTuple):
    """Role, briefing and calls of a record.

    A call is the request and its arrays, the reply and its arrays.
    """

    role: str
    briefing: Struct
    calls: list[tuple[Any, bytes, bytes, bytes]]


def read_record(path: Path) -> RecordedCalls:
    """Read the record of a flight's calls.

    Raises
    ------
    InputError
        If the file is not a record of this version.
    """
    try:
        parts = _parts(path.read_bytes())
        first = new_message("Request")
        first.ParseFromString(parts[0])
    except (OSError, ValueError) as error:
        raise InputError("record", str(path), f"must be a record of messages ({error})") from None
    except Exception:  # google.protobuf.message.DecodeError
        raise InputError("record", str(path), "must be a record of messages") from None
    if first.interface_version != VERSION or first.role not in ROLES:
        raise InputError("record", str(path), f"must have interface version {VERSION}")
    if len(parts) == 2:
        raise InputError("record", str(path), "must have at least one answer")
    if len(parts) % 4 != 2:
        raise InputError("record", str(path), "must be complete; its last call is cut off")
    briefing, given = Struct("Briefing"), Struct(ROLES[first.role].input)
    calls = []
    try:
        from_protobuf(first.briefing, briefing, _Bytes(parts[1]))
        for k in range(2, len(parts), 4):
            request, reply = new_message("Request"), new_message("Reply")
            request.ParseFromString(parts[k])
            reply.ParseFromString(parts[k + 2])
            from_protobuf(getattr(request, f"{first.role}_input"), given, _Bytes(parts[k + 1]))
            calls.append((request, parts[k + 1], parts[k + 2], parts[k + 3]))
    except Exception as error:  # google.protobuf.message.DecodeError, SizeError, ValueError
        problem = f"must be an undamaged record of messages ({type(error).__name__})"
        raise InputError("record", str(path), problem) from None
    return RecordedCalls(first.role, briefing, calls)


def _parts(data: bytes) -> list[bytes]:
    """Split a record into its parts."""
    parts, at = [], 0
    while at < len(data):
        if at + _LENGTH.size > len(data):
            raise ValueError("it is cut off")
        (length,) = _LENGTH.unpack_from(data, at)
        at += _LENGTH.size
        if length > _MAX_PART_BYTES or at + length > len(data):
            raise ValueError("it is cut off or not a record")
        parts.append(data[at : at + length])
        at += length
    if len(parts) < 2:
        raise ValueError("it is empty")
    return parts


class ReplayedCalls(NamedTuple):
    """Number of repeated calls, and the first different answer.

    `first_difference` is its index, or None; `fields` are the names of its fields that differ.
    """

    calls: int
    first_difference: int | None
    fields: str


def replay(record: RecordedCalls, connection: Any) -> ReplayedCalls:
    """Repeat recorded calls with software and compare its answers byte for byte."""
    role = ROLES[record.role]
    given, answer = Struct(role.input), Struct(role.output)
    for n, (request, arrays, wanted, wanted_arrays) in enumerate(record.calls):
        from_protobuf(getattr(request, f"{role.name}_input"), given, _Bytes(arrays))
        answer.clear()
        connection.step(given, answer)
        reply, found_arrays = answer_message(role.name, given, answer)
        found = reply.SerializeToString(deterministic=True)
        if found != wanted or bytes(found_arrays.data) != wanted_arrays:
            before = new_message("Reply")
            before.ParseFromString(wanted)
            output = f"{role.name}_output"
            names = _different(getattr(before, output), getattr(reply, output))
            return ReplayedCalls(n + 1, n, ", ".join(names) or "arrays")
    return ReplayedCalls(len(record.calls), None, "")


def _different(a: Any, b: Any) -> list[str]:
    """Return the names of the fields in which two messages differ."""
    names = [f.name for f in a.DESCRIPTOR.fields]
    return [name for name in names if str(getattr(a, name)) != str(getattr(b, name))]
