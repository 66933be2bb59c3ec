"""NumPy archives from elsewhere: read without pickles, and only up to a size."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Uncompressed bytes of an archive. The largest file that the package reads in this way has 3 MB.
MAX_ARRAY_BYTES = 64_000_000


def read_arrays(path: Path, most: int = MAX_ARRAY_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of a NumPy archive.

    Parameters
    ----------
    path
        Of the file.
    most
        Bytes that its members may have together when they are expanded.

    Raises
    ------
    ValueError
        If the file is missing, damaged, no archive of arrays or larger than that.
    """
    try:
        with zipfile.ZipFile(path) as file:
            members = file.infolist()
            if sum(member.file_size for member in members) > most:
                raise ValueError(f"more than {most / 1e6:g} MB when expanded")
            return {m.filename.removesuffix(".npy"): _array(_read(file, m)) for m in members}
    except (MemoryError, RecursionError):
        raise ValueError("an array larger than the file") from None
    except Exception as error:  # zipfile, zlib and NumPy raise a dozen types on damaged files
        raise ValueError(str(error).split("\n")[0] or type(error).__name__) from None


def _read(file: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return the bytes of a member, never more than it declares.

    `ZipFile.read` expands all that there is before it looks at the declared size; so do all methods
    of compression but this one.
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("compressed by a method that NumPy does not write")
    with file.open(member) as stream:
        return stream.read(member.file_size)


def _array(data: bytes) -> NDArray[Any]:
    """Return the array of one member."""
    found = np.load(io.BytesIO(data), allow_pickle=False)
    if not isinstance(found, np.ndarray):
        raise ValueError("no array")
    return found
