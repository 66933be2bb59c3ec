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
    """Load the scenario that an environment's arguments select, with changed values.

    Parameters
    ----------
    given
        Scenario, path of a TOML file, or name of a scenario that is supplied with lunarsim; None
        selects `otherwise`.
    changes
        New values by scenario key, such as ``{"rocks.cover": 0.1}``, or None.
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
            "must be a Scenario, the path of a TOML file or the name of a supplied scenario",
        )
    named = {} if changes is None else changes
    if not isinstance(named, Mapping) or not all(isinstance(key, str) for key in named):
        raise InputError(
            "changes", changes, "must map keys to values, such as {'rocks.cover': 0.1}"
        )
    return with_values(scenario, named, "changes")


def checked_int(field: str, value: Any, least: int) -> int:
    """Check that an argument is an integer of at least `least`, and return the value.

    `field` is the name of the argument in the error.

    Raises
    ------
    InputError
        If the value is not an integer or is less than `least`.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(field, value, f"must be an integer of at least {least}")
    return int(value)


def checked_covers(given: Any) -> tuple[float, ...]:
    """Check that rock covers (area fractions) are numbers, and return them as a tuple.

    Their bounds are checked later, by the scenario.

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
    """Check that the argument named `field` is a boolean, and return it as a bool.

    Raises
    ------
    InputError
        If the value is not a boolean.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(field, value, "must be True or False")
    return bool(value)


def checked_weights(given: Any, kind: type[Weights]) -> Weights | None:
    """Check that reward weights are None or of the class `kind`, and return them.

    Raises
    ------
    InputError
        If the weights are of another class.
    """
    if not isinstance(given, kind | None):
        raise InputError("weights", given, f"must be {kind.__module__}.{kind.__name__} or None")
    return given


def checked_options(given: Any) -> dict[str, Any]:
    """Return the options of `reset` as a dictionary, which is empty for None.

    Raises
    ------
    InputError
        If the options are not a mapping from names to values.
    """
    named = {} if given is None else given
    if not isinstance(named, Mapping) or not all(isinstance(key, str) for key in named):
        raise InputError(
            "options", given, "must map names to values, such as {'position_m': (0, 0, 500)}"
        )
    return dict(named)


def check_no_render_mode(render_mode: Any) -> None:
    """Check that no render mode is requested from a vector environment.

    Raises
    ------
    InputError
        If the render mode is not None.
    """
    if render_mode is not None:
        raise InputError(
            "render_mode", render_mode, "must be None for vector environments, which do not render"
        )
