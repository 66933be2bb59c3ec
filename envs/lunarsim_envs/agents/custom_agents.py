"""Load custom agents: any callable, given as ``module:Name``."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import gymnasium
import numpy as np

from lunarsim.errors import InputError, error_reason
from lunarsim.parts.registry import CONTRACTS, IMPORT_REMEDY, import_part_module


class CallableAgent:
    """Agent that gets its actions from a user's function or callable object.

    Parameters
    ----------
    call
        Callable ``(observation, info) -> action`` or ``observation -> action``. Its method
        ``begin(rng)``, if there is one, is called before each episode.
    """

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call
        self._informed = _accepts_argument_count(call, 2)

    def begin(self, rng: np.random.Generator) -> None:
        """Call the method ``begin(rng)`` of the callable, if there is one."""
        begin = getattr(self._call, "begin", None)
        if begin is not None:
            begin(rng)

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action that the callable computes from an observation (and info)."""
        return self._call(observation, info) if self._informed else self._call(observation)


def _accepts_argument_count(call: Callable[..., Any], count: int) -> bool:
    """Return whether a callable accepts `count` positional arguments; True if unknown."""
    try:
        inspect.signature(call).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:  # functions written in C may have no signature
        return True
    return True


def _imported(name: str) -> Any:
    """Import the object ``module:Name``; the working directory is searched last.

    If the module or the name does not exist, an `InputError` is raised.
    """
    module, _, attribute = name.partition(":")
    try:
        return getattr(import_part_module(module), attribute)
    except (ImportError, AttributeError, SyntaxError) as error:
        raise InputError(
            "--agent", name,
            f"must name a class or function that can be imported ({error_reason(error)})",
            IMPORT_REMEDY,
        ) from error  # fmt: skip


def contract_of_custom_part(name: str) -> str | None:
    """Return "guidance" or "policy" if ``module:Name`` is such a class, or None.

    A class counts as a guidance law or a policy if it is a dataclass with all members that the
    interface requires. Functions and other classes give None.

    Raises
    ------
    InputError
        If the name cannot be imported.
    """
    found = _imported(name)
    if isinstance(found, type) and is_dataclass(found):
        members = {field.name for field in fields(found)} | set(dir(found))
        for contract in ("guidance", "policy"):
            if members.issuperset(CONTRACTS[contract].required_members):
                return contract
    return None


def custom_agent(env: gymnasium.Env[Any, Any], name: str) -> Any:
    """Import a user's agent by its name ``module:Name``, for an environment.

    A class is instantiated with the environment as its only argument. The instance, or a function,
    is used directly if it has ``begin`` and ``act``; otherwise it is called for every action.

    Raises
    ------
    InputError
        If the name cannot be imported, or the object cannot be called in this way.
    """
    found = _imported(name)
    if isinstance(found, type) and not _accepts_argument_count(found, 1):
        raise InputError(
            "--agent", name, "must be a class that takes the environment as its only argument"
        )
    made = found(env) if isinstance(found, type) else found
    if hasattr(made, "act") and hasattr(made, "begin"):
        return made
    if not callable(made):
        raise InputError("--agent", name, "must be a function, a class or a callable object")
    if not (_accepts_argument_count(made, 1) or _accepts_argument_count(made, 2)):
        raise InputError(
            "--agent", name, "must accept the arguments (observation, info) or (observation)"
        )
    return CallableAgent(made)
