"""Find, list and copy the scenarios that come with the package."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError, suggestion

_PACKAGE = Path(__file__).parent.parent


def folder() -> Path:
    """Return the folder of packaged scenarios: installed, or in the repository."""
    installed = _PACKAGE / "shipped"
    return installed if installed.is_dir() else _PACKAGE.parent / "scenarios"


def names() -> dict[str, Path]:
    """Return the files of all packaged scenarios by name."""
    return {path.stem: path for path in sorted(folder().glob("*.toml"))}


def path_of(name: str) -> Path:
    """Return the file of a packaged scenario.

    Raises
    ------
    InputError
        If no packaged scenario has that name.
    """
    known = names()
    if name not in known:
        raise InputError("NAME", name, "is not a packaged scenario", suggestion(name, known))
    return known[name]


def found(given: Path, beside: Path | None = None) -> Path:
    """Return the path of a scenario by path (first) or by packaged name.

    Parameters
    ----------
    given
        Path of a file, or name of a packaged scenario.
    beside
        Folder of a relative path; None is the working folder.

    Raises
    ------
    InputError
        If there is no such file or name. The error suggests the closest one.
    """
    path = given if beside is None else beside / given
    if path.exists():
        return path
    known = names()
    if str(given) in known:
        return known[str(given)]
    others = [str(given.parent / p.name) for p in path.parent.glob("*.toml") if p.is_file()]
    near = suggestion(str(given), [*known, *others])
    if not near.startswith("Did you mean"):
        near = "Names of packaged scenarios: `lunarsim scenario list`."
    raise InputError("scenario", str(path), "must be an existing TOML file", near)


def description_of(path: Path) -> str:
    """Return the value of the key ``description`` of a scenario file."""
    return str(tomllib.loads(path.read_text(encoding="utf-8")).get("description", ""))


def copy_to(name: str, target: Path) -> list[Path]:
    """Copy a packaged scenario and its data files; return the written files.

    Parameters
    ----------
    name
        Name of the scenario.
    target
        TOML file to write. Data files keep their paths relative to it.

    Raises
    ------
    InputError
        If there is no such scenario, the target exists, or a data file with other contents exists.
    OSError
        If a file cannot be written. All files written before are then removed.
    """
    source = path_of(name)
    tables = tomllib.loads(source.read_text(encoding="utf-8"))
    pairs = [(source, target)]
    pairs += [(source.parent / path, target.parent / path) for path in _named(tables)]
    for old, new in pairs:
        if new.exists() and (new == target or new.read_bytes() != old.read_bytes()):
            raise InputError("--out", str(new), "must be a new file, but it exists")
    with ExitStack() as undo:
        for old, new in pairs:
            if new.exists():
                continue
            missing = [folder for folder in new.parents if not folder.exists()]
            for folder in reversed(missing):
                folder.mkdir()
                undo.callback(folder.rmdir)
            atomic_write(new, partial(shutil.copyfile, old))
            undo.callback(new.unlink)
        undo.pop_all()
    return [new for _, new in pairs]


def _named(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the relative paths in the tables of a scenario."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _named(value)
        elif (key == "path" or key.endswith("_path")) and not Path(str(value)).is_absolute():
            yield str(value)
