"""Files and folders that are complete or absent."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError
from lunarsim.json_files import read_json


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file beside `path`, flush it to the disk, and rename it to `path`.

    Parameters
    ----------
    path
        Readers find the old file or the new one, never a part of it.
    write
        Writes to the path that it is given, which has another suffix.

    Raises
    ------
    OSError
        With `path` as its file name, for instance if the disk is full.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno is not None:
            raise OSError(error.errno, os.strerror(error.errno), str(path)) from error
        raise


def write_text_whole(path: Path, text: str) -> None:
    """Write a text file whole."""

    def write(part: Path) -> None:
        part.write_text(text, encoding="utf-8")

    write_whole(path, write)


def read_tagged(path: Path, field: str, tag: str, hint: str = "") -> dict[str, Any]:
    """Return what a JSON file holds whose key `format` tells what it is.

    Parameters
    ----------
    path
        Of the file.
    field
        That an error names.
    tag
        What `format` must say.
    hint
        Added to errors, such as how the file is made.

    Raises
    ------
    InputError
        If the file is missing, is no JSON, or is another one.
    """
    if not path.is_file():
        raise InputError(field, str(path), f"an existing file{hint}")
    try:
        data = read_json(path)
    except ValueError as error:
        raise InputError(field, str(path), f"JSON ({error}){hint}") from None
    if not isinstance(data, dict) or data.get("format") != tag:
        raise InputError(field, str(path), f"a file with format = {tag!r}{hint}")
    return data


def remover_of_new(folder: Path) -> Callable[[], None]:
    """Return a function that removes what is created in a folder from now on, and empty parents."""
    above = next(p for p in (folder, *folder.absolute().parents) if p.exists()).absolute()
    before = set(folder.iterdir()) if folder.is_dir() else set()

    def remove() -> None:
        for path in set(folder.iterdir()) - before if folder.is_dir() else ():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        created = folder.absolute()
        while created != above and created.is_dir() and not any(created.iterdir()):
            created.rmdir()
            created = created.parent

    return remove


@contextmanager
def filled_whole(folder: Path) -> Iterator[None]:
    """Remove new contents of a folder if an exception ends the block that fills it."""
    remove = remover_of_new(folder)
    try:
        yield
    except BaseException:
        remove()
        raise
