"""Convert pydantic validation errors to input errors that name the scenario key."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import ValidationError

from lunarsim.errors import InputError, suggestion
from lunarsim.parts import PartSettings, loadable_parts, settings_of
from lunarsim.parts.settings import unit_of
from lunarsim.scenario import layout
from lunarsim.scenario.renamed_keys import current_path

# Types of pydantic errors, and the problems that replace pydantic's messages.
_PROBLEMS = {
    "missing": "is required",
    "bool_type": "must be true or false",
    "float_type": "must be a number",
    "int_type": "must be an integer",
    "finite_number": "must be finite",
    "int_from_float": "must be an integer",
    "string_type": "must be a text in quotes",
    "string_too_long": "must have at most {max_length} characters",
    "path_type": "must be a file path in quotes",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "greater_than": "must be more than {gt}",
    "greater_than_equal": "must be {ge} or more",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
    "too_short": "must have at least {min_length} values, not {actual_length}",
    "too_long": "must have at most {max_length} values, not {actual_length}",
    "extra_forbidden": "is an unknown key",
}
# Plural nouns for the elements of a list, by type.
_ELEMENT_WORDS = {float: "numbers", int: "integers", str: "texts in quotes"}
# Maximum number of characters of a list of known keys.
_MAX_HINT_LENGTH = 120
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
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):  # from a conversion of the table
        return cause.with_field(f"{path}.{cause.field}")
    location = [str(step) for step in first["loc"]]
    field = path + "".join(_key_text(step) for step in first["loc"])
    table, depth = _table_at(model, first["loc"])
    key = location[depth] if depth < len(location) else ""
    unit = unit_of(table, key)
    if any(isinstance(step, str) for step in first["loc"][depth + 1 :]) and _is_union(table, key):
        field = path + "".join(_key_text(step) for step in first["loc"][: depth + 1])
        return InputError(field, first["input"], "must be a number or a list of numbers")
    # Only the last index of a missing element is not the index of a list.
    of_list = first["loc"][:-1] if first["type"] == "missing" else first["loc"]
    count = len(_elements(table, key, len(of_list) - depth - 1))
    if count and first["type"] in ("tuple_type", "too_long", "missing"):
        wanted = f"must be a list of {count} values" + (
            f" in {_SPELLED_UNITS.get(unit, unit)}" if unit else ""
        )
        field = path + "".join(_key_text(step) for step in of_list)
        return InputError(field, first["input"], wanted)
    if first["type"] == "extra_forbidden":
        key = location[-1]
        keys = sorted(table.model_fields)
        elsewhere = _kinds_with(contract, key) if contract and len(location) == 1 else []
        if elsewhere:
            whose = " or ".join(repr(name) for name in elsewhere)
            return InputError(
                field, first["input"], f"is not a key of kind {kind!r}",
                f"Delete the key, or use it with {path}.kind = {whose}.", False,
            )  # fmt: skip
        without_keys = f"Kind {kind!r} has no keys." if contract and not keys else ""
        remedy = _other_table(key) or without_keys or key_hint(key, keys)
        return unknown_key_error(field, first["input"], remedy)
    problem = plain_problem(first)
    if first["type"] in ("tuple_type", "list_type"):
        elements = _element_words(table, key, len(first["loc"]) - depth - 1)
        if elements:
            wanted = f"must be a list of {elements}"
            wanted += f" in {_SPELLED_UNITS.get(unit, unit)}" if unit else ""
            return InputError(field, first["input"], wanted)
    wants_number = unit and first["type"].endswith(("_type", "_parsing"))
    remedy = f"Give a plain number {_unit_phrase(unit)}." if wants_number else ""
    if _is_quoted(first["input"], first["type"]):
        remedy = "Delete the quotes."
    return InputError(field, first["input"], problem, remedy, first["type"] != "missing")


def _is_quoted(value: Any, error_type: str) -> bool:
    """Return whether a text would have the type of its key without its quotes.

    `error_type` is pydantic's type of the error.
    """
    if error_type == "bool_type":
        return value in ("true", "false")
    if error_type not in ("float_type", "int_type") or not isinstance(value, str):
        return False
    try:
        return isfinite(float(value) if error_type == "float_type" else int(value))
    except (ValueError, OverflowError):
        return False


def _key_text(step: int | str) -> str:
    """Return the text of a key or list index at the end of a path."""
    return f"[{step}]" if isinstance(step, int) else f".{step}"


def plain_problem(error: Any) -> str:
    """Return the problem that an error of pydantic reports, as a clause."""
    bounds = {
        name: f"{bound:g}" if isinstance(bound, float) else bound
        for name, bound in error.get("ctx", {}).items()
    }
    if error["type"] == "greater_than" and float(bounds["gt"]) == 0.0:
        return "must be positive"
    if error["type"] in _PROBLEMS:
        return _PROBLEMS[error["type"]].format(**bounds)
    message = str(error["msg"]).removeprefix("Value error, ").replace("Input should", "must")
    return message[0].lower() + message[1:]


def key_hint(key: str, known: Iterable[str]) -> str:
    """Return a remedy for an unknown key: the closest key, or all keys."""
    hint = suggestion(key, known, "keys")
    if len(hint) > _MAX_HINT_LENGTH:
        return "All keys are listed by `lunarsim scenario reference`."
    return hint


def _other_table(key: str) -> str:
    """Return a remedy that names the tables which have a key; empty if none has it."""
    fixed = [t for t, cls in (layout.FIXED | layout.OPTIONAL).items() if key in _keys_of(cls)]
    contracts = layout.OPTIONAL_SELECTED | {t: c for t, (c, _) in layout.SELECTED.items()}
    selected = [table for table, contract in contracts.items() if _kinds_with(contract, key)]
    named = [f"{t}.NAME" for t, (c, _) in layout.NAMED.items() if _kinds_with(c, key)]
    tables = [f"[{table}]" for table in fixed + selected + named]
    return f"Tables with this key: {', '.join(tables)}." if tables else ""


def _keys_of(cls: type) -> set[str]:
    return set(settings_of(cls).model_fields)


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
        place = "" if "." in field else " at the top level of the scenario"
        return InputError(field, value, f"is an unknown key{place}", remedy, show_value=False)
    return InputError(
        field, value, f"was renamed to {new}",
        "Use the new name, or run `lunarsim scenario upgrade FILE`.", show_value=False,
    )  # fmt: skip


def _is_union(model: type[PartSettings], key: str) -> bool:
    """Return whether a key accepts several types, such as a number or a list."""
    found = model.model_fields.get(key)
    return found is not None and get_origin(found.annotation) in (Union, UnionType)


def _elements(model: type[PartSettings], key: str, depth: int) -> tuple[Any, ...]:
    """Return the element types of a list of fixed length in a key's value.

    `depth` is the number of indices from the value to the list. The result is empty for any other
    value.
    """
    found = model.model_fields.get(key)
    kind: Any = None if found is None else found.annotation
    for _ in range(depth):
        kind = get_args(kind)[0] if get_origin(kind) is tuple else None
    for one in get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,):
        if get_origin(one) is tuple and Ellipsis not in get_args(one):
            return get_args(one)
    return ()


def _element_words(model: type[PartSettings], key: str, depth: int) -> str:
    """Return a noun for the elements of a list of any length; "" if not a list.

    `depth` is the number of indices from the value to the list.
    """
    found = model.model_fields.get(key)
    kind: Any = None if found is None else found.annotation
    for _ in range(depth):
        kind = get_args(kind)[0] if get_origin(kind) is tuple else None
    for one in get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,):
        if get_origin(one) is tuple and Ellipsis in get_args(one):
            element = get_args(one)[0]
            if get_origin(element) is tuple and Ellipsis not in get_args(element):
                return f"lists of {len(get_args(element))} numbers"
            base = get_args(element)[0] if get_origin(element) is Annotated else element
            return _ELEMENT_WORDS.get(base, "")
    return ""


def _table_at(
    model: type[PartSettings], location: tuple[Any, ...]
) -> tuple[type[PartSettings], int]:
    """Return the innermost settings class on a key path, and its depth in the path.

    `location` is the path of keys and list indices from the table of `model`. The depth is the
    index of the first step that is a key of the returned class.
    """
    for depth, step in enumerate(location):
        field = model.model_fields.get(str(step))
        if field is None or not isinstance(field.annotation, type):
            return model, depth
        if not issubclass(field.annotation, PartSettings) or depth + 1 == len(location):
            return model, depth
        model = field.annotation
    return model, len(location)


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
