"""Convert pydantic errors to input errors with field, value and remedy."""

from __future__ import annotations

from typing import Any, get_args, get_origin

from pydantic import ValidationError

from lunarsim.errors import InputError, suggestion
from lunarsim.parts import PartSettings, loadable_parts, settings_of
from lunarsim.parts.settings import unit_of
from lunarsim.scenario import layout


def input_error(
    path: str, model: type[PartSettings], error: ValidationError, contract: str | None, kind: str
) -> InputError:
    """Convert the first pydantic error of a table to an `InputError`."""
    first = error.errors(include_url=False)[0]
    location = [str(step) for step in first["loc"]]
    field = ".".join([path, *location])
    count = len(_elements(model, location[0])) if location else 0
    if count and first["type"] in ("tuple_type", "too_long", "missing"):
        unit = unit_of(model, location[0])
        wanted = f"must be a list of {count} values" + (f" in {unit}" if unit else "")
        return InputError(f"{path}.{location[0]}", first["input"], wanted)
    if first["type"] == "extra_forbidden":
        key = location[-1]
        keys = sorted(_table_at(model, first["loc"][:-1]).model_fields)
        elsewhere = _kinds_with(contract, key) if contract and len(location) == 1 else []
        if elsewhere:
            whose = " or ".join(repr(name) for name in elsewhere)
            return InputError(
                field, first["input"], f"is not a key of kind {kind!r}", f"Kind {whose} has it."
            )
        hint = layout.MOVED_KEYS.get(path) or suggestion(key, keys)
        return InputError(field, first["input"], "is an unknown key", hint)
    message = str(first["msg"]).removeprefix("Value error, ").replace("Input should", "must")
    problem = "is required" if message == "Field required" else message[0].lower() + message[1:]
    unit = unit_of(model, location[0]) if location else ""
    wants_number = unit and first["type"].endswith(("_type", "_parsing"))
    remedy = f"Give a plain number in {unit}." if wants_number else ""
    return InputError(field, first["input"], problem, remedy)


def _elements(model: type[PartSettings], key: str) -> tuple[Any, ...]:
    """Return the element types of a list with fixed length; empty for other keys."""
    found = model.model_fields.get(key)
    for kind in () if found is None else (found.annotation, *get_args(found.annotation)):
        if get_origin(kind) is tuple and Ellipsis not in get_args(kind):
            return get_args(kind)
    return ()


def _table_at(model: type[PartSettings], location: tuple[Any, ...]) -> type[PartSettings]:
    for step in location:
        field = model.model_fields.get(str(step))
        if field is None or not isinstance(field.annotation, type):
            return model
        model = field.annotation
    return model


def _kinds_with(contract: str, key: str) -> list[str]:
    """Return the kinds of a contract that have a key."""
    found = []
    for kind, part in loadable_parts(contract):
        try:
            table = settings_of(part)
        except Exception:
            continue
        if key in table.model_fields:
            found.append(kind)
    return found
