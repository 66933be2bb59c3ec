"""Connection to flight software in a shared library that runs in this process."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError
from lunarsim.interface.definitions import VERSION
from lunarsim.interface.structs import Struct
from lunarsim.onboard.external.failure import SoftwareFailure


def load_library(path: Path, role: str) -> tuple[Any, Any, Any]:
    """Load a shared library; return the three functions of a role.

    Raises
    ------
    InputError
        If the library cannot be loaded, lacks a function, or has another interface version. The
        field is "path".
    """
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise InputError(
            "path", str(path), "must be a shared library for this machine", f"{error}."
        ) from None
    names = ("lunarsim_interface_version", *(f"lunarsim_{role}_{k}" for k in
             ("init", "step", "close")))  # fmt: skip
    missing = [name for name in names if not hasattr(library, name)]
    if missing:
        raise InputError(
            "path", str(path), f"must define the function {missing[0]}",
            'Include lunarsim.h, which declares it; in C++ it must be extern "C".',
        )  # fmt: skip
    version = library.lunarsim_interface_version
    version.restype, version.argtypes = ctypes.c_uint32, ()
    if version() != VERSION:
        raise InputError(
            "path", str(path),
            f"must have interface version {VERSION}, but has version {version()}",
            "Compile it with the header of this version: lunarsim interface header.",
        )  # fmt: skip
    init, step, close = (getattr(library, name) for name in names[1:])
    pointer = ctypes.c_void_p
    init.argtypes, init.restype = (pointer, ctypes.POINTER(pointer)), ctypes.c_int
    step.argtypes, step.restype = (pointer, pointer, pointer), ctypes.c_int
    close.argtypes, close.restype = (pointer,), None
    return init, step, close


class LibraryConnection:
    """Flight software of one role and one flight in a shared library.

    Parameters
    ----------
    path
        File of the library.
    role
        Name of the role.
    briefing
        Briefing of the software.

    Raises
    ------
    InputError
        If the library is unsuitable, or its initialisation fails.
    """

    def __init__(self, path: Path, role: str, briefing: Struct) -> None:
        self.role = role
        init, self._step, self._close = load_library(path, role)
        state = ctypes.c_void_p()
        code = init(briefing.address, ctypes.byref(state))
        if code != 0:
            raise InputError(
                "path", str(path),
                f"must be initialised without error, but lunarsim_{role}_init returned {code}",
            )  # fmt: skip
        self._state: ctypes.c_void_p | None = state

    def step(self, given: Struct, answer: Struct) -> None:
        """Call the software with input and output of the role.

        Raises
        ------
        SoftwareFailure
            If the software returns an error.
        """
        code = self._step(self._state, given.address, answer.address)
        if code != 0:
            problem = f"lunarsim_{self.role}_step returned {code}"
            raise SoftwareFailure(self.role, "error", problem)

    def close(self) -> None:
        """Let the software free its state; further calls do nothing."""
        if self._state is not None:
            state, self._state = self._state, None
            self._close(state)
