"""What many campaigns need alike, kept on disk: the exact truth of grounds.

An entry is a file of plain arrays, named by a digest of all that it was made from: tables of the
scenario, contents of files they name, seed, code, packages and the processor that kernels are
compiled for. So a stale entry is never found, only never looked for again. Entries are written
beside their place and renamed; each is checked against its own sums when it is read, and one that
cannot be read is made anew. Nothing is executed in reading one.
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

from lunarsim.campaign.files import code_digest, environment
from lunarsim.errors import InputError
from lunarsim.user_cache import user_cache

Arrays = dict[str, NDArray[Any]]

# Of the folder of entries, bytes, unless a caller says otherwise.
LIMIT = 4 * 2**30
# A file takes so much of a disk at least, bytes.
_BLOCK = 4096
# Folders whose sizes are added up again after a share 1 / _CHECKS of the limit has been written.
_CHECKS = 64
# A part of a file that is older has no writer any more, s.
_ABANDONED = 3600.0


class CacheWarning(UserWarning):
    """The folder of the cache cannot be used; results are the same without it."""


@dataclass(frozen=True)
class DiskCache:
    """A folder of entries; travels to workers.

    Attributes
    ----------
    folder
        Where entries are.
    limit
        Of the sizes of all entries together, bytes.
    since
        Entries used from then on (seconds since 1970) make no room for others: a campaign over
        more worlds than fit would else throw out each before its next use.
    """

    folder: Path
    limit: int = LIMIT
    since: float = 0.0

    def get(self, kind: str, key: str, make: Callable[[], Arrays]) -> Arrays:
        """Return the arrays of an entry, made and kept if there are none.

        Parameters
        ----------
        kind
            Short name of what it is.
        key
            All that it depends on, besides code and machine.
        make
            Makes the arrays.
        """
        path = self._path(kind, key)
        found = _read(path)
        if found is None:
            found = make()
            self._keep(path, found)
        return found

    def has_mark(self, key: str) -> bool:
        """Tell whether `mark` was called with this key."""
        return self._path("mark", key).is_file()

    def mark(self, key: str) -> None:
        """Note that something was done on this machine with this code."""
        self._keep(self._path("mark", key), {"done": np.array(True)})

    def _path(self, kind: str, key: str) -> Path:
        digest = hashlib.sha256(f"{_maker()}\0{kind}\0{key}".encode()).hexdigest()[:40]
        return self.folder / digest[:2] / f"{digest}.npz"

    def _keep(self, path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write an entry if there is room; warn once if the folder does not take it."""
        size = sum(a.nbytes for a in arrays.values())
        if self.folder in _given_up or not _has_room(self, size):
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


def standard_folder() -> Path:
    """Return the folder of worlds in this user's cache."""
    return user_cache("worlds")


def opened(folder: Path, limit: int = LIMIT) -> DiskCache | None:
    """Return the cache of a folder for a campaign that begins now.

    None, with a warning, if the folder cannot be written to.

    Raises
    ------
    InputError
        If the folder is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError("--cache", str(folder), "a folder, not a file")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        _give_up(folder, error)
        return None
    return DiskCache(folder.resolve(), limit, time.time())


# Of this process: folders that took no entry, and bytes until a folder's sizes are added up again.
_given_up: set[Path] = set()
_until_check: dict[Path, float] = {}


def _give_up(folder: Path, error: OSError) -> None:
    _given_up.add(folder)
    warnings.warn(
        f"the cache in {folder} cannot be written to ({error.strerror}): worlds are made anew; "
        "results are the same",
        CacheWarning,
        stacklevel=2,
    )


def _read(path: Path) -> Arrays | None:
    """Return the arrays of an entry; None if there is none, or it is not whole."""
    try:
        # First of all its sums: a damaged head that asks for less of an array reads without error.
        with zipfile.ZipFile(path) as file:
            if file.testzip() is not None:
                return None
        with np.load(path, allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files}
    except Exception:
        # None there, cut off, overwritten, or unreadable: the new one takes its place.
        return None
    with contextlib.suppress(OSError):
        os.utime(path)
    return found


def _has_room(store: DiskCache, size: int) -> bool:
    """Tell whether an entry may be added; entries not used of late make room for it."""
    left = _until_check.get(store.folder, 0.0) - max(size, _BLOCK)
    if left < 0.0:
        free = store.limit - _trimmed(store.folder, store.limit - size, store.since)
        left = min(free - max(size, _BLOCK), store.limit / _CHECKS)
        if left < 0.0:
            return False
    _until_check[store.folder] = left
    return True


def _trimmed(folder: Path, most: float, since: float) -> float:
    """Delete entries not used since a time, oldest first, down to a size; return the size left."""
    entries = []
    for path in folder.glob("??/*"):
        with contextlib.suppress(OSError):  # another process may have deleted it
            stat = path.stat()
            if path.suffix == ".part":
                if time.time() - stat.st_mtime > _ABANDONED:
                    path.unlink()
                continue
            entries.append((stat.st_mtime, max(stat.st_size, _BLOCK), path))
    total = float(sum(size for _, size, _ in entries))
    for used, size, path in sorted(entries):
        if total <= most or used >= since:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            total -= size
    return total


@cache
def _maker() -> str:
    """Return what makes bits differ between machines: code, packages, processor."""
    import llvmlite.binding as llvm  # noqa: PLC0415  (slow to load)

    made_by = {k: v for k, v in environment().items() if k != "cores"}
    cpu = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    return repr((code_digest(), sorted(made_by.items()), cpu))
