"""Check folders of results from others before opening or writing files."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from lunarsim.errors import InputError

# Maximum size of a file that is read at once, bytes. A part of a campaign has 1 MB.
MAX_FILE_BYTES = 2**28


def check_no_links(folder: Path) -> None:
    """Check that a folder from others contains no links, pipes or devices.

    A link redirects readers and writers to another folder, and a pipe blocks them for ever.

    Raises
    ------
    InputError
        If there is a link, pipe or device; the message names the first one.
    """
    for root, folders, files in os.walk(folder):
        for path in (Path(root, name) for name in (*folders, *files)):
            try:
                mode = path.lstat().st_mode
            except FileNotFoundError:  # a running campaign has removed it
                continue
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                name = path.relative_to(folder)
                raise InputError(
                    "folder",
                    str(folder),
                    f"must not contain a link, pipe or device such as {str(name)!r}",
                    "Replace the link, pipe or device by a regular file.",
                )


def read_bounded_bytes(path: Path) -> bytes:
    """Return the bytes of a file; raise an error if the file is too large.

    Raises
    ------
    InputError
        If the file has more than `MAX_FILE_BYTES` bytes.
    """
    if path.stat().st_size > MAX_FILE_BYTES:
        raise InputError(
            "folder",
            str(path),
            f"must not contain a file larger than {MAX_FILE_BYTES // 2**20} MiB",
        )
    return path.read_bytes()
