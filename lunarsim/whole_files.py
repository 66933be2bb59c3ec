"""Files and folders that are there whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError
from lunarsim.json_files import read_json


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file beside `path`, bring it to the disk, and rename it to `path`.

    Parameters
    ----------
    path
        What a reader sees: the old file or the new one, never a part of it.
    write
        Writes to the path that it is given, which has another suffix.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
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


@contextmanager
def filled_whole(folder: Path) -> Iterator[None]:
    """Take away again what has come into a folder if what fills it is broken off."""
    above = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    before = set(folder.iterdir()) if folder.is_dir() else set()
    try:
        yield
    except BaseException:
        for path in set(folder.iterdir()) - before if folder.is_dir() else ():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        made = folder.absolute()
        while made != above.absolute() and made.is_dir() and not any(made.iterdir()):
            made.rmdir()
            made = made.parent
        raise
