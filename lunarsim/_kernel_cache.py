"""Cache compiled kernels on disk, with checks of their source and their integrity."""

from __future__ import annotations

import hashlib
import os
import pickle
import tempfile
from functools import lru_cache
from pathlib import Path
from types import FunctionType
from typing import Any

from numba.core import caching

from lunarsim._kernel_sources import sources_digest
from lunarsim.user_cache import expanded, is_writable, user_cache, warn

_DIGEST_BYTES = 16


@lru_cache
def _cache_folder(source_folder: Path) -> Path | None:
    """Return the folder that caches the compiled kernels of the modules in a folder.

    It is the first writable one of: NUMBA_CACHE_DIR, ``__pycache__`` in the source folder, the
    user's cache; None if none is writable.
    """
    name = (
        f"{source_folder.name}_{hashlib.blake2b(bytes(source_folder), digest_size=8).hexdigest()}"
    )
    folders = [source_folder / "__pycache__", user_cache("kernels") / name]
    # Numba's own setting may come from a .numba_config.yaml in the working folder. Its author could
    # then make this process load foreign pickles.
    given = os.environ.get("NUMBA_CACHE_DIR", "")
    if given:
        folders.insert(0, expanded(given) / name)
    usable = next(filter(_can_create, folders), None)
    if given and usable != folders[0]:
        _warn_once(f"NUMBA_CACHE_DIR: cannot write to {given}; kernels are cached elsewhere")
    if usable is None:
        _warn_once("no cache folder is writable: kernels are compiled at each start")
    return usable


def _can_create(folder: Path) -> bool:
    """Create a folder and a temporary file in the folder; return whether this works."""
    if not is_writable(folder):
        return False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


@lru_cache
def _warn_once(text: str) -> None:
    warn(text)


class _CacheLocator(caching.InTreeCacheLocator):  # type: ignore[misc]
    """Provide the cache folder of a kernel and a stamp of all sources linked into it."""

    def __init__(self, function: FunctionType, file: str) -> None:
        super().__init__(function, file)
        self._linked = sources_digest(function.__module__)
        self._cache_path = str(_cache_folder(Path(file).resolve().parent))

    def get_source_stamp(self) -> tuple[Any, bytes, str]:
        """Return a stamp of all sources that are compiled into the kernel.

        Numba's own stamp covers the kernel's file only.
        """
        return super().get_source_stamp(), self._linked, "with checksum"


class _CacheImplementation(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_CacheLocator,)


class _ChecksummedCacheFiles(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Cache files of compiled kernels with checksums; damaged files are replaced."""

    def _load_index(self) -> dict[Any, str]:
        try:
            found: dict[Any, str] = super()._load_index()
        except Exception:  # pickle raises many kinds on a damaged file
            self._report_damage()
            return {}
        return found

    def _load_data(self, name: str) -> Any:
        # Damaged machine code would end the process, so the checksum is verified first.
        stored = Path(self._data_path(name)).read_bytes()
        if _digest(stored[_DIGEST_BYTES:]) != stored[:_DIGEST_BYTES]:
            self._report_damage()
            return None
        return pickle.loads(stored[_DIGEST_BYTES:])

    def _save_data(self, name: str, data: Any) -> None:
        dumped = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(_digest(dumped) + dumped)

    def _report_damage(self) -> None:
        _warn_once("damaged files in the kernel cache: their kernels are compiled again")


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=_DIGEST_BYTES).digest()


class _KernelCache(caching.Cache):  # type: ignore[misc]
    _impl_class = _CacheImplementation

    def __init__(self, function: FunctionType) -> None:
        super().__init__(function)
        locator = self._impl.locator
        self._cache_file: Any = _ChecksummedCacheFiles(
            self.cache_path, self._impl.filename_base, locator.get_source_stamp()
        )

    def save_overload(self, signature: Any, result: Any) -> None:
        """Save a compiled kernel on disk; warn if this fails, for instance on a full disk."""
        try:
            super().save_overload(signature, result)
        except OSError as error:
            _warn_once(f"compiled kernels cannot be saved ({error.strerror})")


def enable_cache(dispatcher: Any, function: FunctionType) -> None:
    """Cache the compiled code of a kernel on disk, if there is a writable folder.

    `dispatcher` is Numba's object for the kernel, `function` its Python function.
    """
    if _cache_folder(Path(function.__code__.co_filename).resolve().parent) is not None:
        dispatcher._cache = _KernelCache(function)
