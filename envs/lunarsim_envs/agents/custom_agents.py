"""Load custom agents: any callable, given as ``module:Name``."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from lunarsim.errors import InputError
from lunarsim.parts.registry import import_part_module


class CallableAgent:
    """Use a callable as an agent.

    Parameters
    ----------
    call
        Callable ``(observation, info) -> action`` or ``observation -> action``. If it has a method
        ``begin(rng)``, that is called before each episode.
    """

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call
        self._informed = _accepts(call, 2)

    def begin(self, rng: np.random.Generator) -> None:
        """Call the callable's ``begin``, if it has one."""
        begin = getattr(self._call, "begin", None)
        if begin is not None:
            begin(rng)

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action of the callable."""
        return self._call(observation, info) if self._informed else self._call(observation)


def _accepts(call: Callable[..., Any], count: int) -> bool:
    """Return whether a callable accepts `count` arguments; True if unknown."""
    try:
        inspect.signature(call).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:  # functions written in C may have no signature
        return True
    return True


def custom_agent(env: gymnasium.Env[Any, Any], name: str) -> Any:
    """Return the agent ``module:Name``.

    A class is instantiated with the environment as its only argument. The instance, or a function,
    is used directly if it has ``begin`` and ``act``; otherwise it is called for every action.

    Raises
    ------
    InputError
        If it cannot be imported, or cannot be called in this way.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_part_module(module), attribute)
    except (ImportError, AttributeError, SyntaxError) as error:
        message = str(error).split("\n")[0]
        raise InputError(
            "--agent", name,
            f"cannot be imported ({type(error).__name__}: {message})",
            "Put the module into the working directory or install it.",
        ) from error  # fmt: skip
    if isinstance(found, type) and not _accepts(found, 1):
        raise InputError(
            "--agent", name, "must be a class that takes the environment as its only argument"
        )
    made = found(env) if isinstance(found, type) else found
    if hasattr(made, "act") and hasattr(made, "begin"):
        return made
    if not callable(made):
        raise InputError("--agent", name, "must be a function, a class or a callable object")
    if not (_accepts(made, 1) or _accepts(made, 2)):
        raise InputError("--agent", name, "must accept (observation, info) or (observation)")
    return CallableAgent(made)
