"""Define the agent interface and shared checks."""

from __future__ import annotations

from typing import Any, Protocol

import gymnasium
import numpy as np

from lunarsim.errors import InputError


class Agent(Protocol):
    """Select actions in an environment; one object flies many episodes in sequence."""

    def begin(self, rng: np.random.Generator) -> None:
        """Start an episode; all random numbers of the agent come from this generator."""
        ...

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action for an observation and the environment's `info`."""
        ...


def incompatible_agent_error(name: str, env: gymnasium.Env[Any, Any], wanted: str) -> InputError:
    """Return the error for an agent that cannot fly an environment."""
    spec = env.spec.id if env.spec is not None else type(env.unwrapped).__name__
    return InputError("--agent", name, f"cannot fly {spec}, because it needs {wanted}")


def check_sites(name: str, env: Any) -> None:
    """Check that the actions of a ``Retarget-v0`` environment include a site.

    Raises
    ------
    InputError
        Naming the agent.
    """
    if not env.actions.has("site"):
        raise incompatible_agent_error(name, env, "Retarget-v0 with the action component 'site'")
