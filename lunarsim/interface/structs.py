"""Messages as C structures in memory, with the layout of the C header."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.interface.definitions import MESSAGES, Field

# NumPy types of the numbers in messages; an array of variable size is a pointer.
NUMBERS: dict[str, type[np.generic]] = {
    "double": np.float64, "float": np.float32, "int32": np.int32, "uint32": np.uint32,
    "uint16": np.uint16, "uint8": np.uint8,
}  # fmt: skip
_POINTER = np.uint64
# Maximum size of an array that is copied: for small ones, faster than taking the address.
_MAX_COPIED = 256


@cache
def dtype_of(message: str) -> np.dtype[np.void]:
    """Return the NumPy type of a message, aligned as in C."""
    return np.dtype([_member(f) for f in MESSAGES[message].fields], align=True)


def _member(f: Field) -> tuple[Any, ...]:
    """Return name, type and shape of a structure's member."""
    if f.count:
        return f.name, _POINTER
    if f.type == "text":
        return f.name, f"S{f.shape[0]}"
    of = dtype_of(f.type) if f.is_message else NUMBERS[f.type]
    return f.name, of, f.shape


@cache
def _empty(message: str) -> NDArray[Any]:
    """Return a structure (1,) whose doubles are NaN and whose other fields are zero."""
    made = np.zeros(1, dtype_of(message))
    for f in MESSAGES[message].fields:
        if f.is_message and not f.count:
            made[f.name] = _empty(f.type)
        elif f.type == "double" and not f.count:
            made[f.name] = np.nan
    return made


def address_of(array: NDArray[Any]) -> int:
    """Return the address of an array's first element."""
    return int(array.__array_interface__["data"][0])


class Struct:
    """Structure of one message; large arrays of variable size stay where they are.

    Parameters
    ----------
    message
        Name of the message.
    buffer
        Memory of the structure (1,); None: new memory, filled with zeros.

    Attributes
    ----------
    message
        Definition of the message.
    buffer, address
        Memory of the structure (1,), and its address.
    parts
        Structures of the fields that are messages; of an array of messages, a list of them.
    arrays, kinds
        Arrays of variable size by field, and their types.
    views, flat
        Views (1, ...) of all fields by name; views of the arrays of fixed size as vectors.
    """

    def __init__(self, message: str, buffer: NDArray[Any] | None = None) -> None:
        self.message = MESSAGES[message]
        self.buffer = np.zeros(1, dtype_of(message)) if buffer is None else buffer
        self.address = address_of(self.buffer)
        self._bytes, self._empty = self.buffer.view(np.uint8), _empty(message).view(np.uint8)
        self.parts: dict[str, Any] = {}
        self.arrays: dict[str, NDArray[Any]] = {}
        self.views = {f.name: self.buffer[f.name] for f in self.message.fields}
        self.flat = {
            f.name: self.views[f.name].reshape(-1)
            for f in self.message.fields
            if f.shape and not f.is_message and f.type != "text"
        }
        self._lists: dict[str, list[Struct]] = {}
        self.kinds = {f.name: NUMBERS[f.type] for f in self.message.fields if f.is_block}
        self._written = {f.name for f in self.message.fields if f.written}
        for f in self.message.fields:
            view = self.views[f.name]
            if f.is_list:
                self._lists[f.name], self.parts[f.name] = [], []
            elif f.is_message and f.shape:
                self.parts[f.name] = [Struct(f.type, view[0, k : k + 1]) for k in range(f.shape[0])]
            elif f.is_message:
                self.parts[f.name] = Struct(f.type, view)

    def set(self, **values: Any) -> None:
        """Set fields of numbers, vectors and texts."""
        for name, value in values.items():
            self.views[name][0] = value

    def clear(self) -> None:
        """Set all numbers of type double to NaN, and all other fields to zero.

        A number that software does not write is then found.
        """
        self._bytes[:] = self._empty

    def get(self, name: str) -> Any:
        """Return a number, a text as bytes, or a view of an array of fixed size."""
        return self.views[name][0]

    def text(self, name: str) -> str:
        """Return a text up to its first zero byte."""
        return bytes(self.get(name)).partition(b"\0")[0].decode("utf-8", "replace")

    def attach(self, **arrays: NDArray[Any]) -> None:
        """Set arrays of variable size.

        Large contiguous ones of the right type, and those that the software writes, are not copied.
        """
        for name, given in arrays.items():
            is_copied = given.size <= _MAX_COPIED and name not in self._written
            current = self.arrays.get(name)
            if is_copied and current is not None and current.shape == given.shape:
                current[...] = given
                continue
            array = np.ascontiguousarray(given, self.kinds[name])
            self.arrays[name] = array = array.copy() if is_copied else array
            self.views[name][0] = address_of(array) if array.size else 0

    def resize_list(self, name: str, count: int) -> list[Struct]:
        """Set the number of elements of a list of messages; return them with old contents."""
        current: list[Struct] = self.parts[name]
        if len(current) == count:
            return current
        elements = self._lists[name]
        if len(elements) < count:
            of = next(f.type for f in self.message.fields if f.name == name)
            memory = np.zeros(count, dtype_of(of))
            elements[:] = [Struct(of, memory[k : k + 1]) for k in range(count)]
        self.views[f"{name}_count"][0] = count
        self.views[name][0] = elements[0].address if count else 0
        self.parts[name] = elements[:count]
        return elements[:count]
