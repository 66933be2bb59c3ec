"""Cache of computed tables, renewed when their code changes."""

from __future__ import annotations

import contextlib
import hashlib
import zipfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from lunarsim.atomic_files import atomic_write_arrays
from lunarsim.typing import Array
from lunarsim.user_cache import user_cache

_PACKAGE = Path(__file__).parents[2]
# Source files on which the shadow tables depend.
_CODE = ("onboard/perception/shadow_model.py", "frames.py", "rocks/*.py")


def cached_table(name: str, key: str, compute: Callable[[], Array]) -> Array:
    """Return a table from the user's cache, or compute and store it.

    The cached table is identical to the computed one. If the cache cannot be read or written, the
    table is computed each time.

    Parameters
    ----------
    name
        Kind of table.
    key
        Text that identifies the parameters of the table.
    compute
        Function that computes the table.
    """
    digest = hashlib.sha256(f"{_source_digest()} {key}".encode()).hexdigest()[:20]
    path = user_cache("tables") / f"{name}-{digest}.npz"
    damaged = OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile
    with contextlib.suppress(*damaged), np.load(path, allow_pickle=False) as file:
        return np.asarray(file["table"], np.float64)
    table = compute()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write_arrays(path, {"table": table})
    return table


@lru_cache(maxsize=1)
def _source_digest() -> str:
    """Return a digest of the source files that compute tables and of NumPy's version."""
    found = hashlib.sha256(np.__version__.encode())
    for pattern in _CODE:
        for file in sorted(_PACKAGE.glob(pattern)):
            found.update(file.read_bytes())
    return found.hexdigest()
