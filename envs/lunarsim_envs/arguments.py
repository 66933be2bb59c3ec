"""Check and convert arguments of the environments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lunarsim.errors import InputError
from lunarsim.rng import SPLITS
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_values
from lunarsim.scenario.shipped import found

Weights = TypeVar("Weights")
# Remedy for faults of sensors and actuators in an environment with kernels.
FAULTS_REMEDY = (
    "Use Retarget-v1 with perception='onboard' (gymnasium.make). Guidance-v1 and Control-v1 have "
    "[domain_randomization]."
)


def scenario_argument(source: Any, changes: Any, default: Scenario) -> Scenario:
    """Load the scenario that an environment's arguments select, with changed values.

    Parameters
    ----------
    source
        Scenario, path of a TOML file, or name of a scenario that is supplied with lunarsim; None
        selects `default`.
    changes
        New values by scenario key, such as ``{"rocks.cover": 0.1}``, or None.
    default
        Default scenario.

    Raises
    ------
    InputError
        If the scenario does not exist, or a key or a value is invalid.
    """
    if source is None:
        scenario = default
    elif isinstance(source, Scenario):
        scenario = source
    elif isinstance(source, (str, Path)):
        scenario = Scenario.load(found(Path(source)))
    else:
        raise InputError(
            "scenario",
            source,
            "must be a Scenario, the path of a TOML file or the name of a packaged scenario",
        )
    named = {} if changes is None else changes
    if not isinstance(named, Mapping) or not all(isinstance(key, str) for key in named):
        raise InputError(
            "changes", changes, "must be a dictionary by scenario key, such as {'rocks.cover': 0.1}"
        )
    made = with_values(scenario, named, "changes")
    if made.computer is not None:
        raise InputError(
            "computer.kind", made.computer.kind,
            "must be omitted, because an environment's agent replaces a part of the onboard "
            "computer of lunarsim",
        )  # fmt: skip
    return made


def checked_int(field: str, value: Any, minimum: int) -> int:
    """Check that an argument is an integer of at least `minimum`, and return it.

    Otherwise an `InputError` for the argument `field` is raised.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < minimum:
        raise InputError(field, value, f"must be an integer of {minimum} or more")
    return int(value)


def checked_covers(covers: Any) -> tuple[float, ...]:
    """Check that rock covers (area fractions) are numbers, and return them as a tuple.

    If they are not a list of numbers, an `InputError` is raised. Their bounds are checked later, by
    the scenario.
    """
    listed = isinstance(covers, Sequence | np.ndarray) and not isinstance(covers, str | bytes)
    kinds = int, float, np.integer, np.floating
    if not listed or not all(isinstance(c, kinds) and not isinstance(c, bool) for c in covers):
        raise InputError("covers", covers, "must be a list of fractions, such as [0.02, 0.1]")
    return tuple(float(one) for one in covers)


def checked_split(split: Any) -> str:
    """Return the name of a split of worlds; an unknown name raises an `InputError`."""
    if not isinstance(split, str) or split not in SPLITS:
        raise InputError("split", split, f"must be one of {', '.join(SPLITS)}")
    return split


def checked_bool(field: str, value: Any) -> bool:
    """Check that an argument is a boolean, and return it as a bool.

    Otherwise an `InputError` for the argument `field` is raised.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(field, value, "must be True or False")
    return bool(value)


def checked_weights(weights: Any, weights_class: type[Weights]) -> Weights | None:
    """Return reward weights that are of a `weights_class`, None, "dense" or "sparse".

    "dense" gives the default weights of the class, "sparse" 1 for a safe landing and otherwise 0.
    If the weights are something else, an `InputError` is raised.
    """
    if isinstance(weights, str) and weights in ("dense", "sparse"):
        names = [field.name for field in fields(weights_class)]  # type: ignore[arg-type]
        sparse = {name: float(name == "safe") for name in names}
        return weights_class(**({} if weights == "dense" else sparse))
    if not isinstance(weights, weights_class | None):
        raise InputError(
            "weights",
            weights,
            f"must be 'dense', 'sparse', a {weights_class.__module__}.{weights_class.__name__} or "
            "None",
        )
    return weights


def checked_options(options: Any) -> dict[str, Any]:
    """Return the options of `reset` as a dictionary, which is empty for None.

    If the options are not a mapping from names to values, an `InputError` is raised.
    """
    named = {} if options is None else options
    if not isinstance(named, Mapping) or not all(isinstance(key, str) for key in named):
        raise InputError(
            "options", options,
            "must be a dictionary by name of option, such as {'position_m': (0, 0, 500)}",
        )  # fmt: skip
    return dict(named)


def check_no_dispersions(dispersions: Any) -> None:
    """Raise an `InputError` if an environment with kernels gets the argument."""
    if dispersions is not None:
        raise InputError(
            "dispersions", dispersions, "must be None, because kernels simulate no faults of parts",
            FAULTS_REMEDY, show_value=False,
        )  # fmt: skip
