"""Define the agent interface and shared checks."""

from __future__ import annotations

from typing import Any, Protocol

import gymnasium
import numpy as np

from lunarsim.errors import InputError


class Agent(Protocol):
    """Interface of an agent, which selects actions; one object flies many episodes."""

    def begin(self, rng: np.random.Generator) -> None:
        """Start an episode; `rng` is the source of all random numbers of the agent."""
        ...

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action for an observation and the environment's `info`."""
        ...


def incompatible_agent_error(
    name: str, env: gymnasium.Env[Any, Any], requirement: str
) -> InputError:
    """Return the error for the agent `name`, which cannot fly the environment `env`.

    `requirement` names the environment or property that the agent requires.
    """
    spec = env.spec.id if env.spec is not None else type(env.unwrapped).__name__
    return InputError(
        "--agent", name, f"must fit the environment {spec}", f"This agent needs {requirement}."
    )


def check_sites(name: str, env: Any) -> None:
    """Check that the actions of a ``Retarget-v1`` environment can choose a site.

    Otherwise an `InputError` for the agent `name` is raised.
    """
    if not env.actions.has("site"):
        raise incompatible_agent_error(name, env, "Retarget-v1 with the action component 'site'")
