"""Compute digests (hashes) of results, one per quantity that a golden case writes."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pyarrow.csv
import pyarrow.parquet

from golden_parts.names import current_json, current_values

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
# Keys that describe the code and the machine, not the result.
_PROVENANCE = {
    "provenance",
    "version",
    "commit",
    "code",
    "created",
    "history",
    "wall_s",
    "machine",
    "description",
    "digests",
    "frames",
}


def digest(value: Any) -> list[str]:
    """Return the hash of an array or another value, and a short summary as text."""
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
    """Return the digest of each quantity in a result folder, by file and quantity.

    The path of the source folder `root` is removed from texts, so that results of different
    folders are equal.
    """
    found: dict[str, list[str]] = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = str(path.relative_to(folder))
        for quantity, value in _quantities(path):
            found[f"{name}:{quantity}"] = digest(_without_root(root, value))
    return found


def _without_root(root: Path | None, value: Any) -> Any:
    """Return a value with the path of the folder `root` removed from all its texts."""
    if root is None or isinstance(value, np.ndarray):
        return value
    return json.loads(json.dumps(value, default=str).replace(f"{root}/", ""))


def _quantities(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield name and value of each quantity in a result file, by its format."""
    if path.suffix == ".parquet":
        yield from _columns(pyarrow.parquet.read_table(path))
    elif path.suffix == ".csv":
        yield from _columns(pyarrow.csv.read_csv(path))
    elif path.suffix == ".nc":
        with h5netcdf.File(path, "r") as file:
            for name, variable in file.variables.items():
                yield name, np.asarray(variable[...])
    elif path.suffix == ".json":
        data = current_json(json.loads(path.read_text(encoding="utf-8")))
        if path.name == "flight.json" and "scenario" in data:
            data["scenario"] = _scenario_values(data["scenario"])
        yield from _leaves("", data)
    elif path.suffix == ".toml":
        yield "values", _scenario_values(path.read_text(encoding="utf-8"))
    elif path.suffix == ".md":
        lines = path.read_text(encoding="utf-8").splitlines()
        text = " ".join(x for x in lines if not any(key in x for key in _PROVENANCE))
        yield "numbers", _NUMBER.findall(text)


def _scenario_values(text: str) -> list[tuple[str, Any]]:
    """Return keys and values of a scenario in TOML, sorted, with current key names."""
    values = current_values(tomllib.loads(text))
    return [(key, values[key]) for key in sorted(values) if key not in _PROVENANCE]


def _columns(table: Any) -> Iterator[tuple[str, Any]]:
    """Yield name and values of each column of a table, without provenance."""
    for name in table.column_names:
        if name not in _PROVENANCE:
            yield name, table[name].to_numpy()


def _leaves(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield dotted key and value of each entry of a JSON document, three levels deep.

    Deeper data is one value. `prefix` is the key of `value`, "" for the complete document.
    """
    if isinstance(value, dict) and prefix.count(".") < 2:
        for key, inner in value.items():
            if key not in _PROVENANCE:
                yield from _leaves(f"{prefix}.{key}" if prefix else key, inner)
    else:
        yield prefix, value
