"""Change values of a scenario by dotted keys, as the option `--set` does.

A key is the path of tables to a value, separated by dots: ``rocks.cover``, ``start.position_m.0``,
``policy``. A number at the end selects an element of a list. The name of a table with a `kind`
stands for that `kind`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from lunarsim.errors import InputError
from lunarsim.scenario import layout
from lunarsim.scenario.scenario import Scenario

_OPTION = "--set"


def path_of(key: str, value: Any = "") -> tuple[str, ...]:
    """Split a dotted scenario key into the names of its tables and of the value.

    A table name such as ``policy`` stands for its kind, ("policy", "kind"), if `value` is a string.
    """
    if key in layout.SELECTED and isinstance(value, str):
        return key, "kind"
    return tuple(key.split("."))


def with_values(scenario: Scenario, values: Mapping[str, Any], where: str) -> Scenario:
    """Return a copy of a scenario with the values of some dotted keys changed.

    Parameters
    ----------
    scenario
        Scenario to change.
    values
        Values by key. If a value changes the `kind` of a table, that table starts from the
        defaults of the new kind.
    where
        Prefix of the field names in errors, for instance ``--set``.

    Raises
    ------
    InputError
        If a key does not exist or a value is invalid.
    """
    if not values:
        return scenario
    data = scenario.to_dict()
    change: dict[str, Any] = {}
    for key, value in values.items():
        field = f"{where}.{key}"
        steps, new = path_of(key, value), value
        if not all(steps):
            raise InputError(
                where, key, "must name a scenario key without empty parts, such as rocks.cover"
            )
        if len(steps) > 1 and steps[-1].isdigit():
            steps, index = steps[:-1], int(steps[-1])
            current = nested_value(change, steps) or nested_value(data, steps)
            new = _with_element(current, index, value, field)
        _set_nested(change, steps, new, field)
    try:
        return scenario.changed(**change)
    except InputError as error:
        raise error.with_field(f"{where}.{error.field}") from None


def with_changes(scenario: Scenario, texts: Sequence[str]) -> Scenario:
    """Return a copy of a scenario with changes given as texts ``KEY=VALUE``.

    Parameters
    ----------
    scenario
        Scenario to change.
    texts
        Changes ``KEY=VALUE`` with TOML values. Strings need no quotes. Paths are relative to the
        working directory.

    Raises
    ------
    InputError
        If a text is not ``KEY=VALUE``, a key does not exist, or a value is invalid.

    Examples
    --------
    >>> from lunarsim.scenario import Scenario
    >>> study = with_changes(Scenario.from_dict({}), ["rocks.cover=0.08", "policy=safest"])
    >>> study.rocks.cover, study.policy.kind
    (0.08, 'safest')
    """
    values = parse_changes(texts)
    try:
        return with_values(scenario, values, _OPTION)
    except InputError as error:
        field = error.field.replace(f"{_OPTION}.", f"{_OPTION} ", 1)
        raise error.with_field(field) from None


def parse_changes(texts: Sequence[str]) -> dict[str, Any]:
    """Parse texts ``KEY=VALUE`` into values by key.

    Raises
    ------
    InputError
        If a text is not ``KEY=VALUE``, or a key occurs twice.
    """
    values: dict[str, Any] = {}
    for text in texts:
        key, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not key or not value:
            raise InputError(_OPTION, text, "must be KEY=VALUE, for example rocks.cover=0.08")
        if key in values:
            raise InputError(_OPTION, text, "must set each key only once")
        values[key] = _parse_value(text, value)
    return values


def _parse_value(change: str, value: str) -> Any:
    """Parse a TOML value, or return it as a string if it is not TOML.

    An InputError is raised for text that begins like a list, a table or a quoted string but is not
    TOML. `change` is the complete ``KEY=VALUE`` for errors.
    """
    try:
        found = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        if value[0] in "[{\"'":
            raise InputError(
                _OPTION, change, "must have a valid TOML value",
                "Check brackets and quotes.",
            ) from None  # fmt: skip
        return value
    if list(found) != ["value"]:
        raise InputError(
            _OPTION, change, "must have one key and one value", "Repeat --set for each key."
        )
    return found["value"]


def nested_value(data: Any, path: tuple[str, ...]) -> Any:
    """Return the value at a path of keys in nested tables and lists; None if missing."""
    for step in path:
        if isinstance(data, Mapping):
            data = data.get(step)
        elif isinstance(data, list | tuple) and step.isdigit() and int(step) < len(data):
            data = data[int(step)]
        else:
            return None
    return data


def _with_element(current: Any, index: int, value: Any, field: str) -> list[Any]:
    """Return a copy of the list `current` with one element replaced by `value`.

    `field` is the field name for errors.
    """
    if not isinstance(current, list | tuple):
        raise InputError(
            field, value, f"ends in the list index {index}, but the scenario has no list there",
            "Omit the index.", show_value=False,
        )  # fmt: skip
    if index >= len(current):
        problem = (
            f"must end in an index from 0 to {len(current) - 1}, because the list has "
            f"{len(current)} values"
        )
        if not current:
            problem = "ends in an index, but the list is empty"
        raise InputError(field, value, problem, show_value=False)
    new = list(current)
    new[index] = value
    return new


def _set_nested(change: dict[str, Any], steps: tuple[str, ...], value: Any, field: str) -> None:
    """Set the value at the path `steps` in the nested dictionary `change`.

    `field` is the field name for errors.
    """
    for step in steps[:-1]:
        inner = change.setdefault(step, {})
        if not isinstance(inner, dict):
            raise InputError(field, value, f"cannot be set, because another change sets {step!r}")
        change = inner
    if isinstance(change.get(steps[-1]), dict):
        raise InputError(field, value, "must not be set both as a table and by its keys")
    change[steps[-1]] = value
