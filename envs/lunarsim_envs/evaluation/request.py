"""Turns what the command line says into a study."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium

from lunarsim.errors import InputError, suggestion
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_changes
from lunarsim.scenario.shipped import found
from lunarsim_envs.descent.core import level
from lunarsim_envs.evaluation.episodes import Study
from lunarsim_envs.retarget import default_scenario
from lunarsim_envs.sites.perception import PERCEPTIONS

# What each environment flies over unless a scenario is given.
_DEFAULTS = {
    "lunarsim/Retarget-v0": default_scenario, "lunarsim/Guidance-v0": level,
    "lunarsim/Control-v0": level,
}  # fmt: skip


def _environment(given: str) -> str:
    """Return the id of a registered environment; ``Guidance-v0`` is short for ``lunarsim/...``.

    Raises
    ------
    InputError
        If there is none of it, or the module before it cannot be imported.
    """
    module, _, name = given.rpartition(":")
    if module:
        try:
            importlib.import_module(module)
        except ImportError as error:
            raise InputError("env", given, f"a module that can be imported ({error})") from None
    for candidate in (name, f"lunarsim/{name}"):
        if candidate in gymnasium.registry:
            return f"{module}:{candidate}" if module else candidate
    known = [one for one in gymnasium.registry if one.startswith("lunarsim/")]
    near = suggestion(name if "/" in name else f"lunarsim/{name}", known)
    raise InputError("env", given, f"an environment that Gymnasium knows; {near}")


def _check_perception(given: str, default: Any) -> None:
    """Refuse a perception that there is not, and any of an environment without one."""
    if given not in PERCEPTIONS:
        raise InputError("--perception", given, suggestion(given, PERCEPTIONS))
    if default is level:
        raise InputError("--perception", given, "left out: of Retarget-v0 alone")


def study(
    env: str, scenario: Path | None, changes: Sequence[str], seed: int, **arguments: Any
) -> Study:
    """Return what is to be flown.

    Parameters
    ----------
    env
        Id, with ``module:`` before it where one registers it.
    scenario, changes
        File or name, None: the environment's own; and ``KEY=VALUE`` each.
    seed
        Root seed.
    arguments
        Of the environment.

    Raises
    ------
    InputError
        If there is no such environment or scenario, or it takes none.
    """
    name = _environment(env)
    own = _DEFAULTS.get(name.rpartition(":")[2])
    if "observation" in arguments and own is None:
        given = ", ".join(arguments["observation"])
        raise InputError("--observation", given, f"left out: {name} is none of lunarsim's")
    if "action" in arguments and own is not default_scenario:
        raise InputError(
            "--action", ", ".join(arguments["action"]), "left out: of Retarget-v0 alone"
        )  # fmt: skip
    if "perception" in arguments:
        _check_perception(arguments["perception"], own)
    flown: Scenario | None = None
    if scenario is not None:
        flown = Scenario.load(found(scenario))
    elif own is not None:
        flown = own()
    elif changes:
        raise InputError("--set", changes[0], f"--scenario as well: {name} says nothing of its own")
    if flown is not None:
        flown = with_changes(flown, tuple(changes))
    return Study(name, flown, dict(arguments), seed)
