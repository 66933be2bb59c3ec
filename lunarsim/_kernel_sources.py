"""Digest of the source that a kernel's compiled code depends on.

Numba links the code of called kernels into the cached code of their caller, and it checks only
whether the caller's own file has changed. Without this digest, a caller would run outdated code
after a change to a kernel in another file.
"""

from __future__ import annotations

import hashlib
import sys
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from lunarsim._work_partition import PartitionedKernel

_PLAIN = (bool, int, float, complex, str, bytes, np.generic)
# Packages whose versions Numba compares itself, or that a kernel takes no constants from.
_FOREIGN = sys.stdlib_module_names | {"numba", "numpy", "scipy"}


def sources_digest(module: str) -> bytes:
    """Return a digest of all sources and constants compiled into a module's kernels.

    The digest covers the files of all kernels that the module's kernels can call, in any package,
    and the values of the constants in these modules. `module` is the name of an imported module; if
    it is still being executed, the digest covers the names that it has defined so far.
    """
    linked = sorted(linked_modules(module) - {module})
    parts = b"".join([_module_bytes(module), *map(_complete_module_bytes, linked)])
    return hashlib.blake2b(parts, digest_size=16).digest()


def linked_modules(module: str) -> frozenset[str]:
    """Return the names of a module and of all modules whose kernels it can call.

    Kernels that are called through other kernels are included.
    """
    found = {module}
    pending = [module]
    while pending:
        for value in vars(sys.modules[pending.pop()]).values():
            name = _module_of(value)
            if name not in found and name in sys.modules and _has_kernels(name):
                found.add(name)
                pending.append(name)
    return frozenset(found)


def _module_of(value: Any) -> str:
    """Return the name of the module that defines an object.

    For a module this is its own name; for objects other than functions, kernels and classes it is
    "".
    """
    if isinstance(value, ModuleType):
        return value.__name__
    value = _function_of(value) or value
    return str(value.__module__) if isinstance(value, (FunctionType, type)) else ""


def _function_of(value: Any) -> Any:
    """Return the Python function of a compiled kernel; None for any other object."""
    # Attributes of other objects are not accessed: some import modules or raise errors.
    if isinstance(value, PartitionedKernel):
        value = value.compiled
    if isinstance(value, Dispatcher):
        return value.py_func
    return value._defn if isinstance(value, _Intrinsic) else None


@cache
def _has_kernels(name: str) -> bool:
    """Return whether a module defines a kernel or an intrinsic.

    The result is False for the standard library, Numba, NumPy and SciPy.
    """
    if name.partition(".")[0] in _FOREIGN:
        return False
    functions = filter(None, map(_function_of, vars(sys.modules[name]).values()))
    return any(function.__module__ == name for function in functions)


def _module_bytes(name: str) -> bytes:
    """Return name, source and constants of a module as bytes.

    The source is empty for an interactive module.
    """
    file = Path(getattr(sys.modules[name], "__file__", None) or "")
    constants = _constants_by_name(vars(sys.modules[name]))
    return repr((name, file.read_bytes() if file.is_file() else b"", constants)).encode()


def _constants_by_name(module_globals: dict[str, Any]) -> dict[str, str]:
    """Return the values of a module's global variables as text, by name.

    The text is empty for variables that kernels cannot use. Names such as `__file__` are omitted.
    """
    return {
        k: _constant_text(v) for k, v in sorted(module_globals.items()) if not k.startswith("__")
    }


# Modules that a module imports are complete by the time that its kernels are defined.
_complete_module_bytes = cache(_module_bytes)


def _constant_text(value: Any) -> str:
    """Return the constant that kernels can take from a global variable, as text.

    It is the value, or the fields of a tuple class; the text is empty for other objects.
    """
    if isinstance(value, _PLAIN):
        return repr(value)
    if isinstance(value, tuple):
        return repr([_constant_text(v) for v in value])
    if isinstance(value, np.ndarray):
        return repr((value.dtype.str, value.shape, value.tobytes()))
    if isinstance(value, type):
        return repr(getattr(value, "_fields", ""))
    if isinstance(value, ModuleType) and value.__name__.partition(".")[0] not in _FOREIGN:
        return repr(
            _constants_by_name({k: v for k, v in vars(value).items() if isinstance(v, _PLAIN)})
        )
    return ""
