"""Resolve the relative paths in a campaign file from the folder of the file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


def resolve_paths(tables: Any, folder: Path, *, is_path: bool = False) -> Any:
    """Return nested tables in which relative paths are replaced by absolute ones.

    Parameters
    ----------
    tables
        Nested tables, a list, or a single value.
    folder
        Folder of the campaign file, from which relative paths start.
    is_path
        Whether `tables` is the value of a key that names a file.
    """
    if isinstance(tables, Mapping):
        return {
            key: resolve_paths(
                value, folder, is_path=(is_path and key == "values") or _names_file(str(key))
            )
            for key, value in tables.items()
        }
    if isinstance(tables, list):
        return [resolve_paths(value, folder, is_path=is_path) for value in tables]
    return str((folder / tables).resolve()) if is_path and isinstance(tables, str) else tables


def _names_file(key: str) -> bool:
    last = key.rpartition(".")[2]
    return last == "path" or last.endswith("_path")
