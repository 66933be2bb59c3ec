"""Resolve the relative paths in a spec from the folder of the spec."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


def resolve_paths(given: Any, folder: Path, *, named: bool = False) -> Any:
    """Return tables whose relative paths start from a folder.

    Parameters
    ----------
    given
        Table, list or value.
    folder
        Folder of the spec.
    named
        Whether `given` is under a key that names a file.
    """
    if isinstance(given, Mapping):
        return {
            key: resolve_paths(
                value, folder, named=(named and key == "values") or _names_file(str(key))
            )
            for key, value in given.items()
        }
    if isinstance(given, list):
        return [resolve_paths(value, folder, named=named) for value in given]
    return str((folder / given).resolve()) if named and isinstance(given, str) else given


def _names_file(key: str) -> bool:
    last = key.rpartition(".")[2]
    return last == "path" or last.endswith("_path")
