"""Convert pydantic validation errors to input errors that name the scenario key."""

from __future__ import annotations

from typing import Any, get_args, get_origin

from pydantic import ValidationError

from lunarsim.errors import InputError, suggestion
from lunarsim.parts import PartSettings, loadable_parts, settings_of
from lunarsim.parts.settings import unit_of
from lunarsim.scenario import layout
from lunarsim.scenario.renamed_keys import current_path

# Requirements in the words of pydantic, and clauses that replace them.
_PLAIN_WORDS = {
    "a valid boolean": "true or false",
    "a valid number": "a number",
    "a valid integer": "an integer",
    "a valid string": "a string",
    "a valid tuple": "a list",
    "a valid list": "a list",
    "a valid dictionary": "a table",
}
# Units of scenario values whose symbol could be misread, spelled out.
_SPELLED_UNITS = {
    "px": "pixels",
    "e-": "electrons",
    "e-/s": "electrons per second",
    "deg": "degrees",
    "deg/s": "degrees per second",
}


def input_error(
    path: str, model: type[PartSettings], error: ValidationError, contract: str | None, kind: str
) -> InputError:
    """Convert the first pydantic error of a scenario table to an `InputError`.

    Parameters
    ----------
    path
        Name of the table, for instance ``sensors.flash``.
    model
        Settings class that refused the table.
    error
        Error of pydantic.
    contract, kind
        Contract and kind of the component that the table configures. `contract` is None for a
        table without a `kind`.
    """
    first = error.errors(include_url=False)[0]
    location = [str(step) for step in first["loc"]]
    steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in first["loc"])
    field = path + "".join(steps)
    count = len(_elements(model, location[0])) if location else 0
    if count and first["type"] in ("tuple_type", "too_long", "missing"):
        unit = unit_of(model, location[0])
        wanted = f"must be a list of {count} values" + (
            f" in {_SPELLED_UNITS.get(unit, unit)}" if unit else ""
        )
        return InputError(f"{path}.{location[0]}", first["input"], wanted)
    if first["type"] == "extra_forbidden":
        key = location[-1]
        keys = sorted(_table_at(model, first["loc"][:-1]).model_fields)
        elsewhere = _kinds_with(contract, key) if contract and len(location) == 1 else []
        if elsewhere:
            whose = " or ".join(repr(name) for name in elsewhere)
            return InputError(
                field, first["input"], f"is not a key of kind {kind!r}",
                f"Delete the key, or use it with {path}.kind = {whose}.", False,
            )  # fmt: skip
        return unknown_key_error(
            field, first["input"], layout.MOVED_KEYS.get(path) or suggestion(key, keys)
        )
    message = str(first["msg"]).removeprefix("Value error, ").replace("Input should", "must")
    if first["type"] == "path_type":
        message = "must be a file path in quotes"
    for words, plain in _PLAIN_WORDS.items():
        message = message.replace(words, plain)
    problem = "is required" if message == "Field required" else message[0].lower() + message[1:]
    unit = unit_of(model, location[0]) if location else ""
    wants_number = unit and first["type"].endswith(("_type", "_parsing"))
    remedy = f"Give a plain number {_unit_phrase(unit)}." if wants_number else ""
    return InputError(field, first["input"], problem, remedy)


def _unit_phrase(unit: str) -> str:
    """Return the words for a unit after "a number", for instance "in kg"."""
    return f"of {_SPELLED_UNITS[unit]}" if unit in _SPELLED_UNITS else f"in {unit}"


def unknown_key_error(field: str, value: object, remedy: str) -> InputError:
    """Return the error for an unknown scenario key; name its new key if renamed.

    Parameters
    ----------
    field
        Dotted path of the unknown key.
    value
        Value of the key; the message omits it.
    remedy
        Remedy for a key that is not the old name of a current key.
    """
    new = current_path(field)
    if new == field:
        return InputError(field, value, "is an unknown key", remedy, show_value=False)
    return InputError(
        field, value, f"was renamed to {new}",
        "Use the new name, or run `lunarsim scenario upgrade FILE`.", show_value=False,
    )  # fmt: skip


def _elements(model: type[PartSettings], key: str) -> tuple[Any, ...]:
    """Return the element types of a key whose value is a list of fixed length.

    The result is empty for a key with any other value.
    """
    found = model.model_fields.get(key)
    for kind in () if found is None else (found.annotation, *get_args(found.annotation)):
        if get_origin(kind) is tuple and Ellipsis not in get_args(kind):
            return get_args(kind)
    return ()


def _table_at(model: type[PartSettings], location: tuple[Any, ...]) -> type[PartSettings]:
    """Return the settings class of the nested table at the keys in `location`."""
    for step in location:
        field = model.model_fields.get(str(step))
        if field is None or not isinstance(field.annotation, type):
            return model
        model = field.annotation
    return model


def _kinds_with(contract: str, key: str) -> list[str]:
    """Return the kinds of a contract's components that have a certain key."""
    found = []
    for kind, part in loadable_parts(contract):
        try:
            table = settings_of(part)
        except Exception:
            continue
        if key in table.model_fields:
            found.append(kind)
    return found
