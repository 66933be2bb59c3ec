"""The scenarios that come with the package: by name, and copied to start from."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError, suggestion
from lunarsim.whole_files import write_whole

_PACKAGE = Path(__file__).parent.parent


def folder() -> Path:
    """Return where they lie: in the package once it is installed, else in the repository."""
    installed = _PACKAGE / "shipped"
    return installed if installed.is_dir() else _PACKAGE.parent / "scenarios"


def names() -> dict[str, Path]:
    """Return the file of each by name."""
    return {path.stem: path for path in sorted(folder().glob("*.toml"))}


def path_of(name: str) -> Path:
    """Return the file of one.

    Raises
    ------
    InputError
        If none has that name.
    """
    known = names()
    if name not in known:
        raise InputError("NAME", name, suggestion(name, known))
    return known[name]


def found(given: Path, beside: Path | None = None) -> Path:
    """Return a file as it is; where there is none, the scenario that is shipped by that name.

    Parameters
    ----------
    given
        Path or name.
    beside
        Folder that a path is relative to; None: the current one.

    Raises
    ------
    InputError
        If it is neither: with the name or the file beside it that is most like it.
    """
    path = given if beside is None else beside / given
    if path.exists():
        return path
    known = names()
    if str(given) in known:
        return known[str(given)]
    others = [str(given.parent / p.name) for p in path.parent.glob("*.toml") if p.is_file()]
    near = suggestion(str(given), [*known, *others])
    if not near.startswith("did you mean"):
        near = "or a name that `lunarsim scenario list` shows"
    raise InputError("scenario", str(path), f"an existing TOML file; {near}")


def description_of(path: Path) -> str:
    """Return what a file says of itself in its first key ``description``."""
    return str(tomllib.loads(path.read_text(encoding="utf-8")).get("description", ""))


def copy_to(name: str, target: Path) -> list[Path]:
    """Copy one, and the files that it names, to start from; return what was written.

    Parameters
    ----------
    name
        Of the scenario.
    target
        TOML file to write; files that it names go to the same places relative to it.

    Raises
    ------
    InputError
        If there is no such scenario, or a file is there already and is another.
    OSError
        If a file cannot be written; nothing is left then.
    """
    source = path_of(name)
    tables = tomllib.loads(source.read_text(encoding="utf-8"))
    pairs = [(source, target)]
    pairs += [(source.parent / path, target.parent / path) for path in _named(tables)]
    for old, new in pairs:
        if new.exists() and (new == target or new.read_bytes() != old.read_bytes()):
            raise InputError("--out", str(new), "a new file: this one is there already")
    with ExitStack() as undo:
        for old, new in pairs:
            if new.exists():
                continue
            missing = [folder for folder in new.parents if not folder.exists()]
            for folder in reversed(missing):
                folder.mkdir()
                undo.callback(folder.rmdir)
            write_whole(new, partial(shutil.copyfile, old))
            undo.callback(new.unlink)
        undo.pop_all()
    return [new for _, new in pairs]


def _named(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the relative paths that a scenario's tables name."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _named(value)
        elif (key == "path" or key.endswith("_path")) and not Path(str(value)).is_absolute():
            yield str(value)
