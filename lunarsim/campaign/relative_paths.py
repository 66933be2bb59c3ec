"""Resolve the relative paths in a campaign file from the folder of the file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


def resolve_paths(given: Any, folder: Path, *, named: bool = False) -> Any:
    """Return nested tables in which relative paths are replaced by absolute ones.

    Parameters
    ----------
    given
        Table, list or value.
    folder
        Folder of the campaign file, from which relative paths start.
    named
        Whether `given` is the value of a key that names a file.
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
