"""Modules that a file may name as "module:Class": none unless the user allows them.

Scenario files are exchanged between people, and the import of a module runs its code. The
permission is an environment variable because processes that this one starts inherit it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from lunarsim.errors import InputError

VARIABLE = "LUNARSIM_ALLOW_MODULES"
_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")
_PART = re.compile(r"([^\W\d][\w.]*):[^\W\d]")


def allowed_modules() -> tuple[str, ...]:
    """Return the modules and packages that files may name in this process."""
    names = (name.strip() for name in os.environ.get(VARIABLE, "").split(","))
    return tuple(dict.fromkeys(name for name in names if name))


def check_allowed(field: str, kind: str, module: str) -> None:
    """Refuse a part of a module that is not allowed, nor is a package that holds it.

    Raises
    ------
    InputError
        Naming `field`, with `kind` as its value.
    """
    if not _NAME.fullmatch(module):
        raise InputError(field, kind, 'the name of a part, or "module:Class"')
    if not any(module == name or module.startswith(f"{name}.") for name in allowed_modules()):
        raise InputError(
            field, kind,
            "code that a file names is not run. If you trust this module, add --allow-module "
            f"{module} (in Python: allow_modules)",
        )  # fmt: skip


def allow_modules(*names: str) -> None:
    """Let files name classes of these modules, in this process and those that it starts.

    Parameters
    ----------
    names
        Modules or packages, such as ``my_package``; a package allows the modules in it.

    Raises
    ------
    InputError
        If a name is not that of a module.
    """
    for name in names:
        if not (isinstance(name, str) and _NAME.fullmatch(name)):
            raise InputError("allow_modules", name, "the name of a module, such as my_package")
    if names:
        os.environ[VARIABLE] = ",".join(dict.fromkeys((*allowed_modules(), *names)))


@contextmanager
def allowing(names: Iterable[str]) -> Iterator[None]:
    """Allow modules until the end of a `with` statement."""
    before = os.environ.get(VARIABLE)
    try:
        allow_modules(*names)
        yield
    finally:
        if before is None:
            os.environ.pop(VARIABLE, None)
        else:
            os.environ[VARIABLE] = before


def modules_in(texts: Iterable[str | None]) -> list[str]:
    """Return the modules of every "module:Class" in texts that the user typed.

    Examples
    --------
    >>> modules_in(["policy=my_package.own:Mine", "rocks.cover=0.1", None])
    ['my_package.own']
    """
    found = [module for text in texts if text is not None for module in _PART.findall(text)]
    return [module for module in found if _NAME.fullmatch(module)]
