"""Generate the scenario reference: keys, defaults, units, bounds, meaning."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from lunarsim.errors import InputError, suggestion
from lunarsim.parts import CONTRACTS, PartSettings, kinds, resolve, settings_of
from lunarsim.parts.settings import bounds_of, unit_of
from lunarsim.scenario import layout


def _first_line(cls: type) -> str:
    return (inspect.getdoc(cls) or "").split("\n")[0]


def parts_list(contract: str | None = None) -> list[str]:
    """Return one line with type, name and description per component for scenarios.

    `contract` is a type of component, for instance "sensor"; None: all types.

    Raises
    ------
    InputError
        If the contract does not exist.
    """
    if contract is not None and contract not in CONTRACTS:
        raise InputError(
            "contract", contract, "must be a type of component", suggestion(contract, CONTRACTS)
        )
    lines = []
    for name in CONTRACTS if contract is None else [contract]:
        for kind in kinds(name):
            try:
                what = _first_line(resolve(name, kind))
            except InputError as error:
                what = f"cannot be loaded: {error.problem}"
            lines.append(f"{name:11s} {kind:16s} {what}")
    return lines


def _rows(
    model: type[PartSettings], prefix: str = "", defaults: PartSettings | None = None
) -> Iterator[tuple[str, ...]]:
    """Yield key, default, unit, bounds and meaning of each key of a scenario table.

    Keys of nested tables are included. `prefix` precedes each key, and `defaults` has the default
    values if a parent table sets them.
    """
    for key, field in model.model_fields.items():
        nested = field.annotation
        value = field.default if defaults is None else getattr(defaults, key)
        if isinstance(nested, type) and issubclass(nested, PartSettings):
            yield from _rows(
                nested, f"{prefix}{key}.", value if isinstance(value, PartSettings) else None
            )
            continue
        required = defaults is None and field.is_required()
        default = "required" if required else _word(value)
        choices = _choices(field.annotation)
        bounds = choices or bounds_of(model, key)
        yield (
            f"{prefix}{key}", default, unit_of(model, key), bounds, field.description or "",
        )  # fmt: skip


def _choices(annotation: Any) -> str:
    if get_origin(annotation) is Literal:
        return " | ".join(_word(a) for a in get_args(annotation))
    return ""


def _word(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, BaseModel):
        return "table"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        return "[" + ", ".join(_word(v) for v in value) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)


def _tables() -> Iterator[tuple[str, str, type[PartSettings] | None]]:
    """Yield heading, description and settings class of each possible scenario table.

    The class is None if a component cannot be loaded.
    """
    for name, of in layout.FIXED.items():
        yield f"[{name}]", _first_line(of), settings_of(of)
    for name, of in layout.OPTIONAL.items():
        yield f"[{name}] (optional)", _first_line(of), settings_of(of)
    chosen = {name: contract for name, (contract, _) in layout.SELECTED.items()}
    chosen |= layout.OPTIONAL_SELECTED
    named = {f"{name}.NAME": contract for name, (contract, _) in layout.NAMED.items()}
    for name, contract in (chosen | named).items():
        for kind in kinds(contract):
            default = layout.SELECTED.get(name, ("", ""))[1] == kind
            heading = f"[{name}] kind = {_word(kind)}" + (" (default)" if default else "")
            heading += " (optional)" * (name in layout.OPTIONAL_SELECTED)
            try:
                of = resolve(contract, kind)
                table = settings_of(of)
            except Exception as error:
                message = error.problem if isinstance(error, InputError) else str(error)
                yield heading, f"cannot be loaded: {message}", None
            else:
                yield heading, _first_line(of), table


_COLUMNS = ("key", "default", "unit", "bounds or choices", "meaning")
_TOP = (
    ("name", '"unnamed"', "", "", "Name of the study"),
    ("description", '""', "", "", "One sentence about the study"),
    ("gravity_m_s2", "1.622", "m/s^2", "> 0, < 1000", "Gravitational acceleration, downward"),
)


def reference_text(*, markdown: bool = False) -> str:
    """Return the reference of all scenario keys: default, unit, bounds and meaning.

    The text is formatted as Markdown tables or as plain text.
    """
    out = _table("Top level", "Keys before the first table.", list(_TOP), markdown)
    for heading, what, model in _tables():
        rows = list(_rows(model)) if model is not None else []
        out += _table(heading, what, rows, markdown)
    return "\n".join(out).rstrip()


def _table(heading: str, what: str, rows: list[tuple[str, ...]], markdown: bool) -> list[str]:
    if markdown:
        lines = [f"## `{heading}`" if heading.startswith("[") else f"## {heading}", "", what, ""]
        if rows:
            lines += ["| " + " | ".join(_COLUMNS) + " |", "| --- " * len(_COLUMNS) + "|"]
            escaped = [[cell.replace("|", "\\|") for cell in row] for row in rows]
            lines += ["| `" + row[0] + "` | " + " | ".join(row[1:]) + " |" for row in escaped]
        return [*lines, ""]
    lines = [heading, f"  {what}"]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(4)]
    for row in rows:
        cells = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=False))
        lines.append(f"    {cells}  {row[4]}".rstrip())
    return [*lines, ""]
