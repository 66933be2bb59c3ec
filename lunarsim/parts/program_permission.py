"""Permission to run programs and libraries that a scenario names; none by default.

People exchange scenario files, and a program can do everything that its user can do. An environment
variable holds the permission, because child processes inherit it.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lunarsim.errors import InputError
from lunarsim.parts.module_permission import variable_restored

ALLOW_PROGRAMS_VARIABLE = "LUNARSIM_ALLOW_PROGRAMS"


def allowed_programs() -> tuple[Path, ...]:
    """Return the absolute paths of the programs that scenario files may run."""
    names = os.environ.get(ALLOW_PROGRAMS_VARIABLE, "").split(os.pathsep)
    return tuple(dict.fromkeys(Path(name).resolve() for name in names if name))


def check_program(field: str, path: Path) -> None:
    """Raise InputError unless a file exists and scenario files may run it.

    `field` is the setting that names the file.
    """
    try:
        resolved = path.resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(field, str(path), f"must be a valid path ({error})") from None
    if resolved not in allowed_programs():
        raise InputError(
            field, str(path), "must name an allowed program, because lunarsim runs its code",
            f"If you trust it, add --allow-program {path} (in Python: allow_programs).",
        )  # fmt: skip
    if not path.is_file():
        raise InputError(field, str(path), "must be an existing file")


def allow_programs(*paths: str | Path) -> None:
    """Permit scenario files to run programs and libraries.

    The permission also holds in child processes.

    Parameters
    ----------
    paths
        Files of the programs. Relative paths start from the working directory.

    Raises
    ------
    InputError
        If a path contains the separator of path lists, or is not a path.
    """
    added = []
    for path in paths:
        try:
            added.append(str(Path(path).resolve()))
        except (TypeError, ValueError, OSError, RuntimeError) as error:
            raise InputError("allow_programs", path, f"must be a path ({error})") from None
        if os.pathsep in added[-1]:
            raise InputError("allow_programs", str(path), f"must not contain {os.pathsep!r}")
    if added:
        known = dict.fromkeys((*map(str, allowed_programs()), *added))
        os.environ[ALLOW_PROGRAMS_VARIABLE] = os.pathsep.join(known)


@contextmanager
def programs_allowed(paths: Iterable[str | Path]) -> Iterator[None]:
    """Let scenario files run programs and libraries within a `with` statement."""
    with variable_restored(ALLOW_PROGRAMS_VARIABLE):
        allow_programs(*paths)
        yield
