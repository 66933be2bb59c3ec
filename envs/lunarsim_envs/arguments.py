"""What environments are told, checked before anything is made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_values
from lunarsim.scenario.shipped import found

Weights = TypeVar("Weights")


def scenario_of(given: Any, changes: Any, otherwise: Scenario) -> Scenario:
    """Return a scenario from itself, a path, a name or nothing, with other values of some keys.

    Raises
    ------
    InputError
        If it is none of these, or a key or a value will not do.
    """
    if given is None:
        scenario = otherwise
    elif isinstance(given, Scenario):
        scenario = given
    elif isinstance(given, (str, Path)):
        scenario = Scenario.load(found(Path(given)))
    else:
        raise InputError(
            "scenario", given, "a Scenario, the path of a TOML file or the name of a shipped one"
        )
    named = {} if changes is None else changes
    if not isinstance(named, Mapping) or not all(isinstance(key, str) for key in named):
        raise InputError("changes", changes, "values by key, such as {'rocks.cover': 0.1}")
    return with_values(scenario, named, "changes")


def whole(field: str, value: Any, least: int) -> int:
    """Return a whole number, at least so much.

    Raises
    ------
    InputError
        If it is none.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(field, value, f"a whole number, at least {least}")
    return int(value)


def covers_of(given: Any) -> tuple[float, ...]:
    """Return covers of rocks.

    Raises
    ------
    InputError
        If they are no numbers; whether they will do is the scenario's to say.
    """
    listed = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str | bytes)
    kinds = int, float, np.integer, np.floating
    if not listed or not all(isinstance(c, kinds) and not isinstance(c, bool) for c in given):
        raise InputError("covers", given, "a list of fractions of the ground, such as [0.02, 0.1]")
    return tuple(float(one) for one in given)


def truth_of(field: str, value: Any) -> bool:
    """Return true or false.

    Raises
    ------
    InputError
        If it is neither.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(field, value, "True or False")
    return bool(value)


def weights_of(given: Any, kind: type[Weights]) -> Weights | None:
    """Return weights of a kind, or None.

    Raises
    ------
    InputError
        If they are something else.
    """
    if not isinstance(given, kind | None):
        raise InputError("weights", given, f"{kind.__name__}, of {kind.__module__}")
    return given


def options_of(given: Any) -> dict[str, Any]:
    """Return the options of a reset; those of None are none.

    Raises
    ------
    InputError
        If they are no options by name.
    """
    named = {} if given is None else given
    if not isinstance(named, Mapping) or not all(isinstance(key, str) for key in named):
        raise InputError("options", given, "values by name, such as {'position_m': (0, 0, 500)}")
    return dict(named)


def no_pictures(render_mode: Any) -> None:
    """Refuse a mode of rendering of a batch.

    Raises
    ------
    InputError
        Unless it is None.
    """
    if render_mode is not None:
        raise InputError("render_mode", render_mode, "None: a batch draws nothing")
