"""Write files and folders atomically: they are complete or absent."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray as xr


def atomic_write(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file atomically: to a temporary file that is then renamed to `path`.

    Several processes may write the same file: the last complete one stays.

    Parameters
    ----------
    path
        File to write. Readers find the old or the new file, never an incomplete one.
    write
        Function that writes the contents to the path in its argument, whose suffix differs from
        that of `path`.

    Raises
    ------
    OSError
        With `path` as its file name, for instance if the disk is full.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno is not None:
            raise OSError(error.errno, os.strerror(error.errno), str(path)) from error
        raise


def atomic_write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8 atomically: it is complete or absent."""

    def write(part: Path) -> None:
        part.write_text(text, encoding="utf-8")

    atomic_write(path, write)


def atomic_write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write named arrays as a compressed ``.npz`` file atomically: complete or absent."""
    import numpy as np  # noqa: PLC0415  (`--help` imports this module and must not load NumPy)

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez_compressed(file, **arrays)

    atomic_write(path, write)


def atomic_write_netcdf(
    path: Path, dataset: xr.Dataset, encoding: Mapping[Hashable, Mapping[str, Any]] | None = None
) -> None:
    """Write an xarray dataset as a NetCDF file atomically (complete or absent).

    HDF5 ends the process with a segmentation fault if it cannot close a file on a full disk. The
    file is therefore created in memory and written by Python.

    Parameters
    ----------
    path
        File to write.
    dataset
        Contents of the file.
    encoding
        Compression of each variable, in the format of `xarray.Dataset.to_netcdf`.
    """
    data = dataset.to_netcdf(engine="h5netcdf", encoding=dict(encoding or {}))
    atomic_write(path, lambda part: part.write_bytes(data))


def new_contents_remover(folder: Path) -> Callable[[], None]:
    """Return a function that removes files and folders newly created in a folder.

    It removes everything directly in `folder` that is not there at the time of this call; files
    added to existing subfolders stay. It also removes parent folders that were created after this
    call and are empty.
    """
    above = next(p for p in (folder, *folder.absolute().parents) if p.exists()).absolute()
    before = set(folder.iterdir()) if folder.is_dir() else set()

    def remove() -> None:
        for path in set(folder.iterdir()) - before if folder.is_dir() else ():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        created = folder.absolute()
        while created != above and created.is_dir() and not any(created.iterdir()):
            created.rmdir()
            created = created.parent

    return remove


@contextmanager
def remove_contents_on_error(folder: Path) -> Iterator[None]:
    """Remove the new contents of a folder if a `with` block raises an exception.

    The new contents are those that `new_contents_remover` removes; the exception is raised again.
    """
    remove = new_contents_remover(folder)
    try:
        yield
    except BaseException:
        remove()
        raise
