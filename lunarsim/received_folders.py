"""Folders of results from elsewhere: files that are safe to open, and to write beside."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from lunarsim.errors import InputError

# Bytes of a file that is read at once: a part of a campaign has 1 MB.
MAX_FILE_BYTES = 2**28


def check_contents(folder: Path) -> None:
    """Refuse a folder that holds links, pipes or devices.

    A link leads readers and writers to another folder, and a pipe keeps them waiting for ever.

    Raises
    ------
    InputError
        Naming the first of them.
    """
    for root, folders, files in os.walk(folder):
        for path in (Path(root, name) for name in (*folders, *files)):
            try:
                mode = path.lstat().st_mode
            except FileNotFoundError:  # of a campaign that is flying
                continue
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                name = path.relative_to(folder)
                raise InputError(
                    "folder", str(folder), f"{name} is a link, pipe or device. Replace it by a file"
                )


def bounded_bytes(path: Path) -> bytes:
    """Return the bytes of a file.

    Raises
    ------
    InputError
        If there are too many.
    """
    if path.stat().st_size > MAX_FILE_BYTES:
        raise InputError("folder", str(path), f"a file of at most {MAX_FILE_BYTES} bytes")
    return path.read_bytes()
