"""Digests of results: one per quantity that a case writes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pyarrow.csv
import pyarrow.parquet

# Keys that describe the code and the machine, not the result.
_PROVENANCE = {"provenance", "version", "commit", "code", "created", "history", "wall_s", "machine"}


def digest(value: Any) -> list[str]:
    """Return the digest of an array or another value, and a summary as text."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        plain = np.ascontiguousarray(value)
        summary = f"{plain.dtype} {plain.shape}"
        if plain.size and plain.dtype.kind != "c":
            summary += f", mean {np.nanmean(plain.astype(np.float64)):.9g}"
        data = f"{plain.dtype.str}{plain.shape}".encode() + plain.tobytes()
    else:
        listed = value.tolist() if isinstance(value, np.ndarray) else value
        text = json.dumps(listed, sort_keys=True, default=str)
        summary, data = text[:60], text.encode()
    return [hashlib.blake2b(data, digest_size=12).hexdigest(), summary]


def digests_of_folder(folder: Path, root: Path | None = None) -> dict[str, list[str]]:
    """Return the digest of each quantity in a result folder.

    In texts, the path of the source folder `root` is removed,
    because terrain file names contain it.
    """
    found: dict[str, list[str]] = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = str(path.relative_to(folder))
        for quantity, value in _quantities(path):
            found[f"{name}:{quantity}"] = digest(_without(root, value))
    return found


def _without(root: Path | None, value: Any) -> Any:
    """Return a value without the path `root` in its texts."""
    if root is None or isinstance(value, np.ndarray):
        return value
    return json.loads(json.dumps(value, default=str).replace(f"{root}/", ""))


def _quantities(path: Path) -> Iterator[tuple[str, Any]]:
    if path.suffix == ".parquet":
        yield from _columns(pyarrow.parquet.read_table(path))
    elif path.suffix == ".csv":
        yield from _columns(pyarrow.csv.read_csv(path))
    elif path.suffix == ".nc":
        with h5netcdf.File(path, "r") as file:
            for name, variable in file.variables.items():
                yield name, np.asarray(variable[...])
    elif path.suffix == ".json":
        yield from _leaves("", json.loads(path.read_text(encoding="utf-8")))
    elif path.suffix in {".md", ".toml"}:
        lines = path.read_text(encoding="utf-8").splitlines()
        yield "text", [x for x in lines if not any(key in x for key in _PROVENANCE)]


def _columns(table: Any) -> Iterator[tuple[str, Any]]:
    for name in table.column_names:
        if name not in _PROVENANCE:
            yield name, table[name].to_numpy()


def _leaves(at: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the entries of the first two levels of a JSON document."""
    if isinstance(value, dict) and at.count(".") < 2:
        for key, inner in value.items():
            if key not in _PROVENANCE:
                yield from _leaves(f"{at}.{key}" if at else key, inner)
    else:
        yield at, value
