"""Permission to load classes that a file names as "module:Class"; none by default.

People exchange scenario files, and importing a module runs its code. An environment variable holds
the permission, because child processes inherit it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from lunarsim.errors import InputError

ALLOW_MODULES_VARIABLE = "LUNARSIM_ALLOW_MODULES"
_MODULE_PATTERN = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")
_PART_PATTERN = re.compile(r"([^\W\d][\w.]*):[^\W\d]")


def allowed_modules() -> tuple[str, ...]:
    """Return the modules and packages whose code scenario and agent files may run."""
    names = (name.strip() for name in os.environ.get(ALLOW_MODULES_VARIABLE, "").split(","))
    return tuple(dict.fromkeys(name for name in names if name))


def check_allowed(field: str, kind: str, module: str) -> None:
    """Raise InputError unless a module, or a package that contains it, is allowed.

    Raises
    ------
    InputError
        If the module is not allowed; `field` is the setting that names it, `kind` its value.
    """
    if not _MODULE_PATTERN.fullmatch(module):
        raise InputError(field, kind, 'must be a known name, or a class as "module:Class"')
    if not any(module == name or module.startswith(f"{name}.") for name in allowed_modules()):
        raise InputError(
            field, kind,
            "must name an allowed module, because importing a module runs its code",
            f"If you trust {module}, add --allow-module {module} (in Python: allow_modules).",
        )  # fmt: skip


def allow_modules(*names: str) -> None:
    """Permit scenario and agent files to load classes of modules.

    Loading a module runs its code. The permission also holds in child processes.

    Parameters
    ----------
    names
        Modules or packages, such as ``my_package``; a package includes its modules.

    Raises
    ------
    InputError
        If a name is not a valid module name.
    """
    for name in names:
        if not (isinstance(name, str) and _MODULE_PATTERN.fullmatch(name)):
            raise InputError("allow_modules", name, "must be a module name, such as my_package")
    if names:
        os.environ[ALLOW_MODULES_VARIABLE] = ",".join(dict.fromkeys((*allowed_modules(), *names)))


@contextmanager
def variable_restored(name: str) -> Iterator[None]:
    """Restore an environment variable at the end of a `with` statement."""
    before = os.environ.get(name)
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = before


@contextmanager
def modules_allowed(names: Iterable[str]) -> Iterator[None]:
    """Let scenario and agent files load classes of modules within a `with` statement."""
    with variable_restored(ALLOW_MODULES_VARIABLE):
        allow_modules(*names)
        yield


def find_module_names(texts: Iterable[str | None]) -> list[str]:
    """Return the modules of all "module:Class" in texts such as command options.

    Texts without one, and None, are ignored.

    Examples
    --------
    >>> find_module_names(["policy=my_package.own:Mine", "rocks.cover=0.1", None])
    ['my_package.own']
    """
    found = [module for text in texts if text is not None for module in _PART_PATTERN.findall(text)]
    return [module for module in found if _MODULE_PATTERN.fullmatch(module)]
