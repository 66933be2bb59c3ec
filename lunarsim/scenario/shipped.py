"""Find, list and copy the scenarios that are supplied with lunarsim."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError, suggestion
from lunarsim.scenario.renamed_keys import RENAMED_SCENARIOS

_PACKAGE = Path(__file__).parent.parent


def folder() -> Path:
    """Return the folder of the scenarios that are supplied with lunarsim."""
    installed = _PACKAGE / "shipped"
    return installed if installed.is_dir() else _PACKAGE.parent / "scenarios"


def names() -> dict[str, Path]:
    """Return the TOML files of all scenarios supplied with lunarsim, by name."""
    files = [*folder().glob("*.toml"), *folder().glob("landers/*.toml")]
    return {path.stem: path for path in sorted(files, key=lambda path: path.stem)}


def path_of(name: str) -> Path:
    """Return the TOML file of a scenario supplied with lunarsim.

    Raises
    ------
    InputError
        If no supplied scenario has that name.
    """
    known = names()
    if name not in known:
        raise InputError(
            "NAME", name, "must be the name of a packaged scenario", _hint(name, known)
        )
    return known[name]


def found(given: Path, base_folder: Path | None = None) -> Path:
    """Find the file of a scenario given by path or by name of a supplied scenario.

    An existing path has priority.

    Parameters
    ----------
    given
        Path of a file, or name of a scenario supplied with lunarsim.
    base_folder
        Folder from which a relative path starts; None is the working folder.

    Raises
    ------
    InputError
        If there is no such file or name. The error suggests the closest one.
    """
    path = given if base_folder is None else base_folder / given
    if path.exists():
        return path
    known = names()
    if str(given) in known:
        return known[str(given)]
    others = [str(given.parent / p.name) for p in path.parent.glob("*.toml") if p.is_file()]
    near = _hint(str(given), [*known, *others])
    if not near.startswith(("Did you mean", "This scenario is now")):
        near = "`lunarsim scenario list` prints the names of packaged scenarios."
    raise InputError(
        "scenario", str(path), "must be an existing TOML file or a packaged scenario", near
    )


def _hint(name: str, known: Iterable[str]) -> str:
    """Return a sentence with the new name of a renamed scenario or the closest name."""
    new = RENAMED_SCENARIOS.get(Path(name).stem)
    return f"This scenario is now named {new}." if new else suggestion(name, list(known))


def description_of(path: Path) -> str:
    """Return the value of the key ``description`` of a scenario file, or ""."""
    return str(tomllib.loads(path.read_text(encoding="utf-8")).get("description", ""))


def copy_to(name: str, target: Path) -> list[Path]:
    """Copy a supplied scenario and its data files; return the paths written.

    A data file that already exists with the same contents is not written again.

    Parameters
    ----------
    name
        Name of the scenario.
    target
        TOML file to write. Data files keep their paths relative to this file.

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
    pairs += [(source.parent / path, target.parent / path) for path in _data_files(tables)]
    for old, new in pairs:
        if new.exists() and (new == target or new.read_bytes() != old.read_bytes()):
            raise InputError("--out", str(new), "must be a file that does not exist yet")
    pairs = [(old, new) for old, new in pairs if not new.exists()]
    with ExitStack() as undo:
        for old, new in pairs:
            missing = [folder for folder in new.parents if not folder.exists()]
            for folder in reversed(missing):
                folder.mkdir()
                undo.callback(folder.rmdir)
            atomic_write(new, partial(shutil.copyfile, old))
            undo.callback(new.unlink)
        undo.pop_all()
    return [new for _, new in pairs]


def _data_files(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the relative paths of data files in the tables of a scenario."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _data_files(value)
        elif (key == "path" or key.endswith("_path")) and not Path(str(value)).is_absolute():
            yield str(value)
