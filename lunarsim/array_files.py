"""Read untrusted NumPy archives: without pickles, and only up to a maximum size."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import error_reason

# Maximum uncompressed size of an archive, bytes. The largest file of the package has 3 MB.
MAX_ARRAY_BYTES = 64_000_000


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
