"""Read JSON files, NumPy archives and folders from others, within size limits."""

from __future__ import annotations

import io
import json
import os
import stat
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, error_reason

# Maximum size of a JSON file, bytes. The manifest of 1,000 arms and 10,000 parts has 3 MB.
MAX_JSON_BYTES = 2**23
# Maximum uncompressed size of an archive, bytes. The largest file of the package has 3 MB.
MAX_ARRAY_BYTES = 64_000_000
# Maximum size of a file that is read at once, bytes. A part of a campaign has 1 MB.
MAX_FILE_BYTES = 2**28


def read_json(path: Path) -> Any:
    """Return the contents of an untrusted JSON file.

    Raises
    ------
    ValueError
        If the file cannot be read, is not JSON in UTF-8, is nested too deep or is too large.
    """
    try:
        is_too_large = path.stat().st_size > MAX_JSON_BYTES
        found = None if is_too_large else json.loads(path.read_text(encoding="utf-8"))
        json.dumps(found, ensure_ascii=False).encode()  # fails for unpaired surrogates
    except RecursionError:
        raise ValueError("its values are nested too deep") from None
    except OSError as error:
        raise ValueError(error.strerror or "the file cannot be read") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"invalid JSON at line {error.lineno}, column {error.colno}") from None
    except UnicodeError:
        raise ValueError("it is not text in UTF-8") from None
    except ValueError:
        raise ValueError("an integer has too many digits") from None
    if is_too_large:
        raise ValueError(f"the file is larger than {MAX_JSON_BYTES // 2**20} MiB")
    return found


def read_arrays(path: Path, max_bytes: int = MAX_ARRAY_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of an untrusted NumPy archive (.npz) by name.

    Parameters
    ----------
    path
        File to read.
    max_bytes
        Maximum uncompressed size of all members together, bytes.

    Raises
    ------
    ValueError
        If the file is missing, damaged, too large, or not an archive of arrays.
    """
    try:
        with zipfile.ZipFile(path) as file:
            members = file.infolist()
            if sum(member.file_size for member in members) > max_bytes:
                raise ValueError(f"the uncompressed size exceeds {max_bytes / 1e6:g} MB")
            return {m.filename.removesuffix(".npy"): _array(_read_member(file, m)) for m in members}
    except (MemoryError, RecursionError):
        raise ValueError("an array is larger than the file") from None
    except zipfile.BadZipFile:
        raise ValueError("it is not an archive of NumPy arrays, or it is damaged") from None
    except Exception as error:  # zipfile, zlib and NumPy raise many types on damaged files
        if "pickle" in str(error):
            raise ValueError("it contains Python objects instead of numbers") from None
        raise ValueError(error_reason(error)) from None


def _read_member(file: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return the uncompressed bytes of a member, at most its declared size.

    `ZipFile.read` decompresses everything before it checks the declared size. Compression methods
    that NumPy does not use raise an error, because they cannot be limited.
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("NumPy does not use this compression method")
    with file.open(member) as stream:
        return stream.read(member.file_size)


def _array(data: bytes) -> NDArray[Any]:
    found = np.load(io.BytesIO(data), allow_pickle=False)
    if not isinstance(found, np.ndarray):
        raise ValueError("a member is not an array")
    return found


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
