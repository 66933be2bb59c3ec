"""Keys of a scenario as people write them, and values laid over a scenario by such keys.

A key is the path of tables down to a value, with dots between: ``rocks.cover``,
``start.position_m.0``, ``policy``; a number at its end is an element of a list. The name of a table
with a `kind` alone stands for its `kind`.
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
    """Return the steps of a key; the name of a part's table with a text as value means its kind."""
    if key in layout.CHOSEN and isinstance(value, str):
        return key, "kind"
    return tuple(key.split("."))


def with_values(scenario: Scenario, values: Mapping[str, Any], where: str) -> Scenario:
    """Return a scenario with other values.

    Parameters
    ----------
    scenario
        The study.
    values
        Value by key; a table of another `kind` starts from that kind's defaults.
    where
        Put before the field of an error.

    Raises
    ------
    InputError
        If a key is not one of the scenario's, or a value will not do.
    """
    if not values:
        return scenario
    data = scenario.to_dict()
    change: dict[str, Any] = {}
    for key, value in values.items():
        field = f"{where}.{key}"
        steps, new = path_of(key, value), value
        if not all(steps):
            raise InputError(field, value, "a key of the scenario such as rocks.cover")
        if len(steps) > 1 and steps[-1].isdigit():
            steps, index = steps[:-1], int(steps[-1])
            new = _replaced(at(change, steps) or at(data, steps), index, value, field)
        _lay(change, steps, new, field)
    try:
        return scenario.changed(**change)
    except InputError as error:
        raise error.renamed(f"{where}.{error.field}") from None


def with_changes(scenario: Scenario, texts: Sequence[str]) -> Scenario:
    """Return a scenario with changes as the command line gives them.

    Parameters
    ----------
    scenario
        The study.
    texts
        ``KEY=VALUE`` each, the value as TOML has it; a word needs no quotes. Paths are relative to
        the working directory.

    Raises
    ------
    InputError
        Naming the key, if a text is no change or a value will not do.

    Examples
    --------
    >>> from lunarsim.scenario import Scenario
    >>> study = with_changes(Scenario.from_dict({}), ["rocks.cover=0.08", "policy=safest"])
    >>> study.rocks.cover, study.policy.kind
    (0.08, 'safest')
    """
    values = typed_values(texts)
    try:
        return with_values(scenario, values, _OPTION)
    except InputError as error:
        field = error.field.replace(f"{_OPTION}.", f"{_OPTION} ", 1)
        raise error.renamed(field) from None


def typed_values(texts: Sequence[str]) -> dict[str, Any]:
    """Return the value by key of texts ``KEY=VALUE``.

    Raises
    ------
    InputError
        If a text is no change, or a key is given twice.
    """
    values: dict[str, Any] = {}
    for text in texts:
        key, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not key or not value:
            raise InputError(_OPTION, text, "KEY=VALUE such as rocks.cover=0.08")
        if key in values:
            raise InputError(_OPTION, text, "each key once")
        values[key] = _parsed(text, value)
    return values


def _parsed(text: str, value: str) -> Any:
    """Return a value as TOML has it; what is none is a word."""
    try:
        found = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        if value[0] in "[{\"'":
            raise InputError(_OPTION, text, "a value as TOML has it, or a word") from None
        return value
    if list(found) != ["value"]:
        raise InputError(_OPTION, text, "one key and one value")
    return found["value"]


def at(data: Any, steps: tuple[str, ...]) -> Any:
    """Return the value of plain tables at the steps of a key, None where there is none."""
    for step in steps:
        if isinstance(data, Mapping):
            data = data.get(step)
        elif isinstance(data, list | tuple) and step.isdigit() and int(step) < len(data):
            data = data[int(step)]
        else:
            return None
    return data


def _replaced(current: Any, index: int, value: Any, field: str) -> list[Any]:
    """Return a list with one element replaced."""
    if not isinstance(current, list | tuple):
        raise InputError(field, value, "an element of a list that the scenario has")
    if index >= len(current):
        raise InputError(field, value, f"an element from 0 to {len(current) - 1}")
    new = list(current)
    new[index] = value
    return new


def _lay(change: dict[str, Any], steps: tuple[str, ...], value: Any, field: str) -> None:
    """Lay one value into a nested change."""
    for step in steps[:-1]:
        inner = change.setdefault(step, {})
        if not isinstance(inner, dict):
            raise InputError(field, value, f"no key below {step!r}, which is set as a whole")
        change = inner
    if isinstance(change.get(steps[-1]), dict):
        raise InputError(field, value, "a table as a whole or keys in it, not both")
    change[steps[-1]] = value
