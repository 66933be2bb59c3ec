"""Check and convert arguments of the environments."""

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


def scenario_argument(given: Any, changes: Any, otherwise: Scenario) -> Scenario:
    """Return a scenario from an object, path, name or None, with changed values.

    Parameters
    ----------
    given
        Scenario, path of a TOML file, or name of a packaged scenario; None is `otherwise`.
    changes
        Values by key, or None.
    otherwise
        Default scenario.

    Raises
    ------
    InputError
        If the scenario does not exist, or a key or a value is invalid.
    """
    if given is None:
        scenario = otherwise
    elif isinstance(given, Scenario):
        scenario = given
    elif isinstance(given, (str, Path)):
        scenario = Scenario.load(found(Path(given)))
    else:
        raise InputError(
            "scenario",
            given,
            "must be a Scenario, the path of a TOML file or the name of a packaged scenario",
        )
    named = {} if changes is None else changes
    if not isinstance(named, Mapping) or not all(isinstance(key, str) for key in named):
        raise InputError("changes", changes, "must be values by key, such as {'rocks.cover': 0.1}")
    return with_values(scenario, named, "changes")


def checked_int(field: str, value: Any, least: int) -> int:
    """Return an integer with a lower bound.

    Raises
    ------
    InputError
        If the value is not an integer or is less than `least`.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(field, value, f"must be an integer of at least {least}")
    return int(value)


def checked_covers(given: Any) -> tuple[float, ...]:
    """Return rock covers as a tuple; the scenario checks their bounds.

    Raises
    ------
    InputError
        If the covers are not a list of numbers.
    """
    listed = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str | bytes)
    kinds = int, float, np.integer, np.floating
    if not listed or not all(isinstance(c, kinds) and not isinstance(c, bool) for c in given):
        raise InputError("covers", given, "must be a list of fractions, such as [0.02, 0.1]")
    return tuple(float(one) for one in given)


def checked_bool(field: str, value: Any) -> bool:
    """Return a boolean.

    Raises
    ------
    InputError
        If the value is not a boolean.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(field, value, "must be True or False")
    return bool(value)


def checked_weights(given: Any, kind: type[Weights]) -> Weights | None:
    """Return reward weights of a class, or None.

    Raises
    ------
    InputError
        If the weights are of another class.
    """
    if not isinstance(given, kind | None):
        raise InputError("weights", given, f"must be {kind.__module__}.{kind.__name__} or None")
    return given


def checked_options(given: Any) -> dict[str, Any]:
    """Return the options of a reset as a dictionary; None has no options.

    Raises
    ------
    InputError
        If the options are not values by name.
    """
    named = {} if given is None else given
    if not isinstance(named, Mapping) or not all(isinstance(key, str) for key in named):
        raise InputError(
            "options", given, "must be values by name, such as {'position_m': (0, 0, 500)}"
        )
    return dict(named)


def check_no_render_mode(render_mode: Any) -> None:
    """Check that a vector environment has no render mode.

    Raises
    ------
    InputError
        If the render mode is not None.
    """
    if render_mode is not None:
        raise InputError(
            "render_mode", render_mode, "must be None for vector environments, which do not render"
        )
