"""Disk cache of data for many campaigns: the true landing safety of terrains.

An entry is a file of plain arrays. Its name is a digest of everything that it depends on: tables
of the scenario, contents of the files they name, seed, code, packages, and the processor that
kernels are compiled for. A stale entry therefore has another name and is never read. Entries are
written to a temporary file and renamed. Checksums are verified on reading; an unreadable entry is
computed again. Reading an entry executes no code.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.campaign.provenance import code_digest, environment
from lunarsim.errors import InputError
from lunarsim.user_cache import user_cache

Arrays = dict[str, NDArray[Any]]

# Default limit of the size of the cache, bytes.
DEFAULT_CACHE_BYTES = 4 * 2**30
# Minimum disk space of a file, bytes.
_DISK_BLOCK_BYTES = 4096
# The folder size is measured again after 1 / _CHECKS of the limit has been written.
_SIZE_CHECKS_PER_LIMIT = 64
# A temporary file older than this has no live writer, s.
_ABANDONED_AFTER_S = 3600.0


class CacheWarning(UserWarning):
    """The cache folder cannot be used; results do not depend on the cache."""


@dataclass(frozen=True)
class DiskCache:
    """Disk cache of computed arrays, in a folder that worker processes share.

    Attributes
    ----------
    folder
        Folder of the entries.
    limit
        Maximum total size of all entries, bytes.
    since
        Start of the campaign, seconds since 1970. Entries used later are never evicted: a campaign
        with more data than fit would otherwise evict each entry before its next use.
    """

    folder: Path
    limit: int = DEFAULT_CACHE_BYTES
    since: float = 0.0

    def get(self, kind: str, key: str, make: Callable[[], Arrays]) -> Arrays:
        """Return the arrays of an entry; compute and store them if the entry is missing.

        Parameters
        ----------
        kind
            Short name of the type of data.
        key
            Everything that the data depend on, except code and machine.
        make
            Function that computes the arrays, called without arguments.

        Returns
        -------
        dict of ndarray
            Arrays by name, as `make` returns them.
        """
        path = self._path(kind, key)
        found = _read(path)
        if found is None:
            found = make()
            self._store(path, found)
        return found

    def has_mark(self, key: str) -> bool:
        """Return whether `mark` has recorded the task `key` as done on this machine."""
        return self._path("mark", key).is_file()

    def mark(self, key: str) -> None:
        """Record that the task `key` was done on this machine with this code."""
        self._store(self._path("mark", key), {"done": np.array(True)})

    def _path(self, kind: str, key: str) -> Path:
        """Return the file of an entry; its name is a digest of type, key and environment."""
        digest = hashlib.sha256(f"{_environment_key()}\0{kind}\0{key}".encode()).hexdigest()[:40]
        return self.folder / digest[:2] / f"{digest}.npz"

    def _store(self, path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write the arrays of an entry to `path` if there is space; warn once on failure."""
        size = sum(a.nbytes for a in arrays.values())
        if self.folder in _given_up or not _make_space(self, size):
            return
        temporary = ""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(".part", ".", path.parent)
            with os.fdopen(handle, "wb") as file:
                np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub has no such overload
            Path(temporary).replace(path)
        except OSError as error:
            if temporary:
                with contextlib.suppress(OSError):
                    Path(temporary).unlink()
            _give_up(self.folder, error)


def default_cache_folder() -> Path:
    """Return the default folder of cached terrain safety for this user."""
    return user_cache("worlds")


def open_cache(folder: Path, limit: int = DEFAULT_CACHE_BYTES) -> DiskCache | None:
    """Open the cache in a folder for a campaign that starts now.

    `limit` is the maximum size of the cache, bytes. Return None, with a warning, if the folder is
    not writable.

    Raises
    ------
    InputError
        If the path is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError("--cache", str(folder), "must be a folder, not a file")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        _give_up(folder, error)
        return None
    return DiskCache(folder.resolve(), limit, time.time())


# Per process: folders that refused an entry, and bytes to write until the next size check.
_given_up: set[Path] = set()
_until_check: dict[Path, float] = {}


def _give_up(folder: Path, error: OSError) -> None:
    _given_up.add(folder)
    warnings.warn(
        f"Cannot write to the cache in {folder} ({error.strerror}). Worlds are computed again; "
        "results are the same.",
        CacheWarning,
        stacklevel=2,
    )


def _read(path: Path) -> Arrays | None:
    """Return the arrays in the file of a cache entry; None if missing or damaged."""
    try:
        # Check sums first: a damaged header with a smaller array shape reads without an error.
        with zipfile.ZipFile(path) as file:
            if file.testzip() is not None:
                return None
        with np.load(path, allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files}
    except Exception:
        # Missing, truncated, overwritten or unreadable: a new entry replaces it.
        return None
    with contextlib.suppress(OSError):
        os.utime(path)
    return found


def _make_space(cache: DiskCache, size: int) -> bool:
    """Return whether an entry of `size` bytes fits into the cache.

    Entries that were not used recently are deleted to make space.
    """
    left = _until_check.get(cache.folder, 0.0) - max(size, _DISK_BLOCK_BYTES)
    if left < 0.0:
        free = cache.limit - _evict_entries(cache.folder, cache.limit - size, cache.since)
        left = min(free - max(size, _DISK_BLOCK_BYTES), cache.limit / _SIZE_CHECKS_PER_LIMIT)
        if left < 0.0:
            return False
    _until_check[cache.folder] = left
    return True


def _evict_entries(folder: Path, max_bytes: float, since: float) -> float:
    """Delete the entries unused for longest until the cache has at most `max_bytes`.

    Entries used after `since` (seconds since 1970) are kept. Return the remaining size in bytes.
    """
    entries = []
    for path in folder.glob("??/*"):
        with contextlib.suppress(OSError):  # another process may have deleted it
            stat = path.stat()
            if path.suffix == ".part":
                if time.time() - stat.st_mtime > _ABANDONED_AFTER_S:
                    path.unlink()
                continue
            entries.append((stat.st_mtime, max(stat.st_size, _DISK_BLOCK_BYTES), path))
    total = float(sum(size for _, size, _ in entries))
    for used, size, path in sorted(entries):
        if total <= max_bytes or used >= since:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            total -= size
    return total


@cache
def _environment_key() -> str:
    """Return what makes results differ between machines: code, packages, processor."""
    import llvmlite.binding as llvm  # noqa: PLC0415  (slow to load)

    made_by = {k: v for k, v in environment().items() if k != "cores"}
    cpu = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    return repr((code_digest(), sorted(made_by.items()), cpu))
