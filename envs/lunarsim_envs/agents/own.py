"""Agents of one's own: any callable, ``module:Name``."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from lunarsim.errors import InputError
from lunarsim.parts.registry import imported


class CalledAgent:
    """A callable ``(observation, info) -> action``, or one that takes the observation alone.

    Parameters
    ----------
    call
        Is called for every action; `begin(rng)` before a flight, if it has that.
    """

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call
        self._informed = _takes(call, 2)

    def begin(self, rng: np.random.Generator) -> None:
        """Tell the callable of a new flight, if it listens."""
        begin = getattr(self._call, "begin", None)
        if begin is not None:
            begin(rng)

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return what the callable gives."""
        return self._call(observation, info) if self._informed else self._call(observation)


def _takes(call: Callable[..., Any], count: int) -> bool:
    """Tell whether a callable takes so many positional arguments; if it does not say, it does."""
    try:
        inspect.signature(call).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:  # of what is written in C
        return True
    return True


def own_agent(env: gymnasium.Env[Any, Any], name: str) -> Any:
    """Return the agent that ``module:Name`` names.

    A class is built with the environment; what it gives, or the function itself, is an agent if it
    has ``begin`` and ``act``, and else is called for every action.

    Raises
    ------
    InputError
        If it cannot be imported, or is nothing that can be called so.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(imported(module), attribute)
    except (ImportError, AttributeError, SyntaxError) as error:
        said = str(error).split("\n")[0]
        raise InputError(
            "--agent", name,
            "module:Name that can be imported, from the working directory or an installed package "
            f"({type(error).__name__}: {said})",
        ) from error  # fmt: skip
    if isinstance(found, type) and not _takes(found, 1):
        raise InputError("--agent", name, "a class that is built with the environment alone")
    made = found(env) if isinstance(found, type) else found
    if hasattr(made, "act") and hasattr(made, "begin"):
        return made
    if not callable(made):
        raise InputError("--agent", name, "a function, a class, or an object that can be called")
    if not (_takes(made, 1) or _takes(made, 2)):
        raise InputError("--agent", name, "one that takes observation and info, or the former")
    return CalledAgent(made)
