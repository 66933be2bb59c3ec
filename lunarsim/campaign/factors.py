"""Arms: the variants of a scenario that a campaign compares over the same draws."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.onboard.policies.contract import RetargetingPolicy
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import parse_changes, path_of, with_values

# Tables that define the terrain and the truth about it, together with the seed.
GROUND_TABLES = ("terrain", "rocks")
TRUTH_TABLES = (*GROUND_TABLES, "vehicle")
# A larger number is probably a mistake in the spec.
MAX_ARMS = 1000
# Maximum length of a folder name, bytes; file systems allow 255.
_MAX_FOLDER_NAME_BYTES = 240


@dataclass(frozen=True)
class Arm:
    """Variant of a campaign's scenario, in which some values are set.

    Attributes
    ----------
    name
        Name in tables and folders.
    values
        Values by key of the scenario.
    scenario
        Scenario with these values.
    policy
        Policy object given by the caller; None: the scenario's policy.
    """

    name: str
    values: Mapping[str, Any]
    scenario: Scenario
    policy: RetargetingPolicy | None = None


def flatten_keys(table: Any, path: str, value_types: type | tuple[type, ...]) -> dict[str, Any]:
    """Flatten a table to one level, whose keys are dotted.

    Keys of the table may be dotted, or nested tables, which may have dotted keys.

    Parameters
    ----------
    table
        Table as read from TOML.
    path
        Name of the table in messages.
    value_types
        Types that are values, not tables.

    Raises
    ------
    InputError
        If an entry is neither a table nor a value, or a key occurs twice.
    """
    if not isinstance(table, Mapping):
        raise InputError(path, table, "must be a table")
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, value_types):
            inner = {key: value}
        elif isinstance(value, Mapping) and Mapping not in _as_tuple(value_types):
            below = flatten_keys(value, f"{path}.{key}", value_types)
            inner = {f"{key}.{rest}": v for rest, v in below.items()}
        else:
            problem = "must be a list of values" if value_types is list else "must be a number"
            raise InputError(f"{path}.{key}", value, problem)
        for name in inner:
            if name in found:
                raise InputError(
                    f"{path}.{name}", inner[name], "must be given only once, dotted or in a table",
                    show_value=False,
                )  # fmt: skip
        found |= inner
    return found


def _as_tuple(leaf: type | tuple[type, ...]) -> tuple[type, ...]:
    return leaf if isinstance(leaf, tuple) else (leaf,)


def product(factors: Mapping[str, Sequence[Any]]) -> list[tuple[str, dict[str, Any]]]:
    """Return name and values of every combination of factor levels.

    `factors` lists the values of each scenario key; the last key varies fastest.

    Raises
    ------
    InputError
        If a factor has no value or a repeated value, or there are too many combinations.
    """
    for key, levels in factors.items():
        if not isinstance(levels, list | tuple) or not levels:
            raise InputError(f"factors.{key}", levels, "must be a list of at least one value")
        for level in levels:
            check_plain(f"factors.{key}", level)
        words = [json.dumps(level) for level in levels]
        if len(set(words)) < len(words):
            raise InputError(f"factors.{key}", list(levels), "must contain each value only once")
    count = int(np.prod([float(len(levels)) for levels in factors.values()])) if factors else 1
    if count > MAX_ARMS:
        raise InputError("factors", count, f"must give at most {MAX_ARMS} arms")
    combinations = itertools.product(*factors.values())
    return [(_arm_name(values), values) for c in combinations
            for values in [dict(zip(factors, c, strict=True))]]  # fmt: skip


def check_plain(field: str, value: Any) -> None:
    """Refuse values that no key accepts: dates, times and integers above 64 bits.

    Raises
    ------
    InputError
        For such a value; `field` is the name in the message.
    """
    try:
        json.dumps(value)
    except TypeError:
        expected = "must be a number, text, true or false, list or table"
        raise InputError(field, str(value), expected) from None
    if isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(field, value, "must be an integer of at most 64 bits")


def _arm_name(values: Mapping[str, Any]) -> str:
    """Return the name of a variant: its only value, or key=value of each factor.

    `values` are the scenario values that the variant sets, by key.
    """
    if not values:
        return "all"
    if len(values) == 1:
        return format_short(next(iter(values.values())))
    return ", ".join(f"{key}={format_short(value)}" for key, value in values.items())


def format_short(value: Any) -> str:
    """Format a scenario value as a short text for names of variants."""
    if isinstance(value, str):
        if Path(value).is_absolute():
            return Path(value).name
        return value.rpartition(":")[2] if ":" in value else value
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    return json.dumps(value)


def parse_arms(tables: Any) -> list[tuple[str, dict[str, Any]]]:
    """Return name and scenario values of the variants listed as ``[[arms]]``.

    Raises
    ------
    InputError
        If an arm has no name, or its table has other keys.
    """
    if not isinstance(tables, list) or not tables:
        raise InputError(
            "arms", tables, "must be tables [[arms]], each with a name and a table `set`"
        )
    found = []
    for i, table in enumerate(tables):
        path = f"arms.{i}"
        if not isinstance(table, Mapping):
            raise InputError(path, table, "must be a table with the keys name and set")
        for key in set(table) - {"name", "set"}:
            raise InputError(
                f"{path}.{key}", table[key], "is an unknown key", "Known names: name, set.", False
            )
        if "name" not in table:
            raise InputError(f"{path}.name", None, "is required", show_value=False)
        name = table["name"]
        if not isinstance(name, str) or not name:
            raise InputError(f"{path}.name", name, "must be a text that is not empty")
        values = table.get("set", {})
        if not isinstance(values, Mapping):
            raise InputError(f"{path}.set", values, "must be a table of values by key")
        found.append((name, dict(values)))
    return found


def build_arms(
    scenario: Scenario, combinations: Sequence[tuple[str, dict[str, Any]]], field: str
) -> tuple[Arm, ...]:
    """Build the arms (variants of a scenario) of a campaign and check their scenarios.

    `combinations` has name and values of each arm; `field` is the field name for errors.

    Raises
    ------
    InputError
        If two arms have one name, or a scenario is not valid.
    """
    folders = Counter(folder_name(name) for name, _ in combinations)
    for name, _ in combinations:
        if len(folder_name(name).encode()) > _MAX_FOLDER_NAME_BYTES:
            raise InputError(
                field, name[:40] + "...",
                f"must have names of at most {_MAX_FOLDER_NAME_BYTES} bytes, because they name "
                "folders", "Give shorter names with [[arms]].",
            )  # fmt: skip
        if folders[folder_name(name)] > 1:
            raise InputError(
                field, name,
                "must give each arm a name that differs in more than special characters",
                "Give other names with [[arms]].",
            )  # fmt: skip
    if len(combinations) > MAX_ARMS:
        raise InputError(field, len(combinations), f"must give at most {MAX_ARMS} arms")
    return tuple(Arm(n, values, with_values(scenario, values, field)) for n, values in combinations)


def group_arms_by_terrain(arms: Sequence[Arm]) -> tuple[tuple[int, ...], ...]:
    """Group the indices of arms (variants of a scenario) by their terrain and rocks."""
    found: dict[str, list[int]] = {}
    for i, arm in enumerate(arms):
        found.setdefault(tables_as_text(arm.scenario, GROUND_TABLES), []).append(i)
    return tuple(tuple(group) for group in found.values())


def tables_as_text(scenario: Scenario, tables: tuple[str, ...]) -> str:
    """Return the named tables of a scenario as text, for use as a dictionary key.

    Two texts are equal if and only if the tables are equal.
    """
    data = scenario.to_dict()
    return repr({name: data.get(name) for name in tables})


def folder_name(arm: str) -> str:
    """Replace characters of an arm's name that folder names do not allow.

    An arm is a variant of the scenario.
    """
    kept = "".join(c if c.isalnum() or c in "-_.=, " else "_" for c in arm).strip(". ")
    return kept or "arm"


def parse_factors(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Parse lists of values from texts ``key=a,b,c`` or ``key=low:high:count``.

    Raises
    ------
    InputError
        If a text has neither form.
    """
    factors: dict[str, list[Any]] = {}
    for text in texts:
        key, sign, values = text.partition("=")
        key = key.strip()
        if not sign or not key or not values.strip():
            raise InputError("--over", text, "must be KEY=A,B,C or KEY=LOW:HIGH:COUNT")
        if key in factors:
            raise InputError(
                "--over",
                text,
                "must give each key only once",
                "Give all values of a key in one --over.",
            )
        factors[key] = (
            _parse_range(text, values) if values.count(":") == 2 else _parse_list(text, values)
        )
    return factors


def split_changes(
    texts: Sequence[str], factors: Mapping[str, Sequence[Any]]
) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Separate changes of the scenario from keys of components whose kind is a factor.

    A key of such a component, for instance ``policy.hysteresis``, applies to the kinds that the
    factor sets, not to the kind in the scenario.

    Parameters
    ----------
    texts
        Changes, each ``KEY=VALUE``.
    factors
        Values by key.

    Returns
    -------
    tuple
        Texts ``KEY=VALUE`` that apply to the scenario; values of the other keys, by key.

    Raises
    ------
    InputError
        If a text is not a change, or sets a key that is a factor.
    """
    swept = [path_of(key, levels[0]) for key, levels in factors.items()]
    parts = [steps[:-1] for steps in swept if steps[-1] == "kind"]
    kept, of_parts = [], {}
    for text, (key, value) in zip(texts, parse_changes(texts).items(), strict=True):
        steps = path_of(key, value)
        if any(steps[: len(one)] == one for one in swept):
            raise InputError("--set", text, "must not set a key that --over sets")
        if any(steps[: len(part)] == part for part in parts):
            of_parts[key] = value
        else:
            kept.append(text)
    return tuple(kept), of_parts


def _parse_range(text: str, values: str) -> list[Any]:
    low, high, count = (part.strip() for part in values.split(":"))
    try:
        ends, number = (float(low), float(high)), int(count)
    except ValueError:
        # "module:Class" has one colon, so it is not parsed as a range.
        raise InputError(
            "--over", text, "must be KEY=LOW:HIGH:COUNT with two numbers and an integer"
        ) from None
    if number < 2 or not np.isfinite(ends).all() or ends[0] >= ends[1]:
        raise InputError("--over", text, "must have LOW below HIGH, and a COUNT of 2 or more")
    if number > MAX_ARMS:
        raise InputError("--over", text, f"must have a COUNT of at most {MAX_ARMS}")
    return [float(v) for v in np.linspace(*ends, number)]


def _parse_list(text: str, values: str) -> list[Any]:
    words = [part.strip() for part in values.split(",")]
    if not all(words):
        raise InputError("--over", text, "must not contain an empty value")
    return [_parse_value(part) for part in words]


def _parse_value(text: str) -> Any:
    """Return a number, true or false, or the text itself."""
    try:
        value = json.loads(text)
    except json.JSONDecodeError:
        return text
    return value if isinstance(value, bool | int | float) else text
