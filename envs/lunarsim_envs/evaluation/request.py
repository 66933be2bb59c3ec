"""Convert command-line options to a study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium

from lunarsim.errors import InputError, suggestion
from lunarsim.parts.registry import import_part_module
from lunarsim.rng import SPLITS
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_changes
from lunarsim.scenario.shipped import found
from lunarsim_envs.descent.core import flat_scenario
from lunarsim_envs.evaluation.episodes import EvaluationStudy
from lunarsim_envs.retarget import default_scenario
from lunarsim_envs.sites.perception import PERCEPTIONS

# Default scenario of each environment.
_DEFAULTS = {
    "lunarsim/Retarget-v1": default_scenario, "lunarsim/Guidance-v1": flat_scenario,
    "lunarsim/Control-v1": flat_scenario,
}  # fmt: skip


def _environment_id(env_name: str) -> str:
    """Return the id of the registered environment that a user names.

    The prefix ``lunarsim/`` may be omitted; ``module:`` imports a module first. If the environment
    does not exist, or the module cannot be imported, an `InputError` is raised.
    """
    module, _, name = env_name.rpartition(":")
    if module:
        try:
            import_part_module(module)
        except ImportError as error:
            raise InputError(
                "env",
                env_name,
                f"must name a module that can be imported ({error})",
                "Install the module, or start lunarsim in its folder.",
            ) from None
    for candidate in (name, f"lunarsim/{name}"):
        if candidate in gymnasium.registry:
            return f"{module}:{candidate}" if module else candidate
    known = [one for one in gymnasium.registry if one.startswith("lunarsim/")]
    near = suggestion(name if "/" in name else f"lunarsim/{name}", known)
    raise InputError("env", env_name, "must be a registered environment", near)


def _check_perception(perception: str, create_default: Any) -> None:
    """Check the option ``--perception``, the source of hazard maps in ``Retarget-v1``.

    If `perception` is not the name of such a source, or `create_default`, which creates the default
    scenario of the environment, is that of a descent environment, an `InputError` is raised.
    """
    if perception not in PERCEPTIONS:
        raise InputError(
            "--perception", perception, "is unknown", suggestion(perception, PERCEPTIONS)
        )
    if create_default is flat_scenario:
        raise InputError(
            "--perception", perception, "applies only to Retarget-v1", "Omit this option."
        )


def evaluation_study(
    env: str, scenario: Path | None, changes: Sequence[str], seed: int, **arguments: Any
) -> EvaluationStudy:
    """Check command-line options and return the definition of an evaluation.

    Parameters
    ----------
    env
        Id of the environment, with prefix ``module:`` if a module registers it.
    scenario
        File or name of a scenario; None is the default of the environment.
    changes
        Scenario changes ``KEY=VALUE``.
    seed
        Root seed of the episodes.
    arguments
        Other arguments of the environment.

    Raises
    ------
    InputError
        If the environment or the scenario does not exist, or an argument does not apply.
    """
    name = _environment_id(env)
    own = _DEFAULTS.get(name.rpartition(":")[2])
    if "observation" in arguments and own is None:
        given = ", ".join(arguments["observation"])
        raise InputError("--observation", given, f"does not apply to {name}", "Omit this option.")
    if "action" in arguments and own is not default_scenario:
        raise InputError(
            "--action", ", ".join(arguments["action"]), "applies only to Retarget-v1",
            "Omit this option.",
        )  # fmt: skip
    if "dispersions" in arguments and own is not default_scenario:
        raise InputError(
            "--dispersions", arguments["dispersions"], "applies only to Retarget-v1",
            "Omit this option.",
        )  # fmt: skip
    if "perception" in arguments:
        _check_perception(arguments["perception"], own)
    for argument in ("split", "worlds", "world_seed"):
        if argument in arguments and own is None:
            raise InputError(
                f"--{argument.replace('_', '-')}", arguments[argument], f"does not apply to {name}",
                "Omit this option.",
            )  # fmt: skip
    split = arguments.get("split", "test")
    if split not in SPLITS:
        raise InputError("--split", split, "is unknown", suggestion(split, SPLITS))
    if own is not None:
        worlds = 16 if own is default_scenario else 1
        arguments = {"split": "test", "worlds": worlds} | arguments
    flown: Scenario | None = None
    if scenario is not None:
        flown = Scenario.load(found(scenario))
    elif own is not None:
        flown = own()
    elif changes:
        raise InputError(
            "--set",
            changes[0],
            f"needs --scenario, because {name} has no default scenario",
            show_value=False,
        )
    if flown is not None:
        flown = with_changes(flown, tuple(changes))
    return EvaluationStudy(name, flown, dict(arguments), seed)
