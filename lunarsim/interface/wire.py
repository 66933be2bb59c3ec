"""Sockets and shared memory between lunarsim and flight software in a process."""

from __future__ import annotations

import contextlib
import mmap
import os
import socket
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Environment variables with which a program is started.
ADDRESS_VARIABLE, TOKEN_VARIABLE = "LUNARSIM_ADDRESS", "LUNARSIM_TOKEN"
# Maximum size of a message without its arrays, bytes.
MAX_MESSAGE_BYTES = 2**26
_LENGTH = struct.Struct("<I")
# Number of bytes to receive at once.
_RECEIVED_BYTES = 2**16
_ALIGNMENT = 64
_FIRST_SIZE = 2**20


class WireError(Exception):
    """A message is not readable, or the other side has closed the connection."""


class Channel:
    """Connection that sends and receives Protobuf messages, each after its length.

    The length is an unsigned integer of 32 bits, little-endian.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._socket, self._received = connection, bytearray()
        if connection.family != socket.AF_UNIX:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, message: Any, deadline: float | None = None) -> None:
        """Send a message; `deadline` is the last time (s, `time.monotonic`) to do so.

        Raises
        ------
        WireError
            If the other side has closed the connection, or has sent more than it was asked for.
        TimeoutError
            If the other side does not read the message before the deadline.
        """
        self._socket.settimeout(0.0)
        with contextlib.suppress(OSError):  # there is nothing to receive
            self._received += self._socket.recv(_RECEIVED_BYTES)
        if self._received:
            raise WireError("a message arrived before its request")
        data = message.SerializeToString()
        left = None if deadline is None else max(deadline - time.monotonic(), 1e-3)
        self._socket.settimeout(left)
        try:
            self._socket.sendall(_LENGTH.pack(len(data)) + data)
        except TimeoutError:
            raise
        except OSError as error:
            raise WireError(f"the connection is closed ({error})") from None

    def receive(self, message: Any, deadline: float | None = None) -> None:
        """Receive a message; `deadline` is the last time (s, `time.monotonic`) to do so.

        Raises
        ------
        WireError
            If the connection is closed, or the message is not readable.
        TimeoutError
            If the message does not arrive before the deadline.
        """
        (length,) = _LENGTH.unpack(self._read(_LENGTH.size, deadline))
        if length > MAX_MESSAGE_BYTES:
            raise WireError(f"a message of {length} bytes is too long")
        data = self._read(length, deadline)
        try:
            message.ParseFromString(data)
        except Exception:  # google.protobuf.message.DecodeError
            raise WireError("a message is not readable") from None

    def _read(self, count: int, deadline: float | None) -> bytes:
        """Return the next bytes; what arrives with them is kept for the next call."""
        while len(self._received) < count:
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0.0:
                raise TimeoutError
            self._socket.settimeout(left)
            try:
                part = self._socket.recv(_RECEIVED_BYTES)
            except TimeoutError:
                raise
            except OSError as error:
                raise WireError(f"the connection is closed ({error})") from None
            if not part:
                raise WireError("the connection is closed")
            self._received += part
        data = bytes(self._received[:count])
        del self._received[:count]
        return data

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class SharedArrays:
    """File in memory in which arrays of variable size lie.

    Parameters
    ----------
    path
        File of the memory.
    is_owner
        Whether to create the file; else it exists.
    """

    def __init__(self, path: Path, *, is_owner: bool) -> None:
        self.path = path
        flags = os.O_RDWR | (os.O_CREAT | os.O_EXCL if is_owner else 0)
        self._file = os.open(path, flags, 0o600)
        self._end = 0
        if is_owner:
            os.ftruncate(self._file, _FIRST_SIZE)
        self._map()

    def _map(self) -> None:
        self.size = os.fstat(self._file).st_size
        # Arrays keep an earlier, smaller map alive.
        self._memory = np.frombuffer(mmap.mmap(self._file, self.size), np.uint8)

    def clear(self) -> None:
        """Let new arrays replace the present ones."""
        self._end = 0

    def place(self, array: NDArray[Any]) -> int:
        """Copy an array into the memory; return its offset in bytes."""
        start = -(-self._end // _ALIGNMENT) * _ALIGNMENT
        self._end = start + array.nbytes
        if self._end > self.size:
            os.ftruncate(self._file, 2 * self._end)
            self._map()
        self._memory[start : self._end] = array.reshape(-1).view(np.uint8)
        return start

    def view(self, offset: int, count: int, dtype: Any) -> NDArray[Any]:
        """Return an array (count,) in the memory, without a copy.

        Raises
        ------
        WireError
            If the array does not lie in the memory.
        """
        size = np.dtype(dtype).itemsize
        end = offset + count * size
        if end > self.size:
            self._map()
        if end > self.size or offset % size:
            raise WireError("an array does not lie in the shared memory")
        return self._memory[offset:end].view(dtype)

    def close(self) -> None:
        """Close the file; arrays in the memory stay valid."""
        os.close(self._file)
