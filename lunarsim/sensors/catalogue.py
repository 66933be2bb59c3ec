"""Catalogue of named sensor units, whose values fill the keys of a sensor table."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError


@dataclass(frozen=True)
class SensorUnit:
    """Sensor of a manufacturer, with sources for its values.

    Attributes
    ----------
    kind
        Kind of the sensor, such as "imu".
    description, source
        Manufacturer and type; publication that states the values.
    values
        For each dotted key of the sensor table: value, and its source in `source` or "estimated"
        with the reason.
    """

    kind: str
    description: str
    source: str
    values: dict[str, tuple[Any, str]]

    def table(self) -> dict[str, Any]:
        """Return kind and values as a sensor table of a scenario."""
        out: dict[str, Any] = {"kind": self.kind}
        for key, (value, _) in self.values.items():
            *tables, last = key.split(".")
            inner = out
            for name in tables:
                inner = inner.setdefault(name, {})
            inner[last] = value
        return out


@cache
def sensor_units() -> dict[str, SensorUnit]:
    """Return the units of the catalogue by name."""
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    return {name: SensorUnit(**table) for name, table in tomllib.loads(text).items()}


def complete_table(path: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a sensor table with the values of its `unit` for omitted keys.

    `path` is the name of the table. A table without the key `unit` is returned unchanged.

    Raises
    ------
    InputError
        If the unit does not exist, or is of another kind than the table.
    """
    name = table.get("unit")
    if name is None:
        return dict(table)
    known = sensor_units()
    if not isinstance(name, str) or name not in known:
        raise InputError(
            f"{path}.unit", name, "must be the name of a sensor unit",
            f"Units: {', '.join(known)}.",
        )  # fmt: skip
    unit = known[name]
    if table.get("kind", unit.kind) != unit.kind:
        raise InputError(
            f"{path}.unit", name, f"must be a unit of kind {table['kind']!r}",
            f"{name} is of kind {unit.kind!r}.",
        )  # fmt: skip
    return _merged(unit.table(), table)


def with_unit_values(path: str, change: Mapping[str, Any], kind: str) -> Mapping[str, Any]:
    """Return a change of a sensor table, with all values of its `unit`.

    `path` is the name of the table and `kind` its kind before the change. A change without `unit`,
    or with an unknown one, is returned unchanged.

    Raises
    ------
    InputError
        If the unit is of another kind than the table.
    """
    name = change.get("unit")
    known = isinstance(name, str) and name in sensor_units()
    return complete_table(path, {"kind": kind} | dict(change)) if known else change


def catalogue_lines() -> Iterator[str]:
    """Yield the text of the catalogue: each unit with its values and their sources."""
    for name, unit in sensor_units().items():
        yield f"{name} ({unit.kind}): {unit.description}"
        yield f"  source: {unit.source}"
        for key, (value, source) in unit.values.items():
            yield f"    {key:32s} {value!s:20s} {source}"
        yield ""


def _merged(base: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with the values of `given`, table by table."""
    out = dict(base)
    for key, value in given.items():
        inner = out.get(key)
        if isinstance(inner, dict) and isinstance(value, Mapping):
            out[key] = _merged(inner, value)
        else:
            out[key] = value
    return out
