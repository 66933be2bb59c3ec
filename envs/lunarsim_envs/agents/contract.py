"""What an agent is, and what it is built from."""

from __future__ import annotations

from typing import Any, Protocol

import gymnasium
import numpy as np

from lunarsim.errors import InputError


class Agent(Protocol):
    """Flies an environment; one object flies many flights, one after another."""

    def begin(self, rng: np.random.Generator) -> None:
        """A flight begins; what the agent draws in it comes from this generator."""
        ...

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action for an observation and what the environment told beside it."""
        ...


def refuse(name: str, env: gymnasium.Env[Any, Any], wanted: str) -> InputError:
    """Return the error of an agent that cannot fly an environment."""
    spec = env.spec.id if env.spec is not None else type(env.unwrapped).__name__
    return InputError("--agent", name, f"an agent of {spec}; {name} flies {wanted}")


def check_sites(name: str, env: Any) -> None:
    """Refuse an environment ``Retarget-v0`` the actions of which choose no sites.

    Raises
    ------
    InputError
        Naming the agent.
    """
    if not env.actions.has("site"):
        raise refuse(name, env, "Retarget-v0 with the part 'site' among its actions")
