"""Agents that know nothing: what they reach is what an environment gives away."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from lunarsim_envs.agents.contract import refuse
from lunarsim_envs.descent.env import DescentEnv


class Zero:
    """Zero in every number of the action, or the first of discrete actions.

    Parameters
    ----------
    env
        Whose actions.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        space = env.action_space
        if isinstance(space, spaces.Discrete):
            self._action: Any = np.int64(space.start)
        elif isinstance(space, spaces.Box):
            self._action = np.zeros(space.shape, space.dtype)
        else:
            raise refuse("zero", env, "environments whose actions are a Box or Discrete")

    def begin(self, rng: np.random.Generator) -> None:
        """Draw nothing."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the same action as ever."""
        return self._action


class Random:
    """Any action, each as likely as another; of discrete ones any that is available.

    Parameters
    ----------
    env
        Whose actions.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        space = env.action_space
        if not isinstance(space, spaces.Discrete | spaces.Box):
            raise refuse("random", env, "environments whose actions are a Box or Discrete")
        self._space = space
        self._rng = np.random.default_rng(0)

    def begin(self, rng: np.random.Generator) -> None:
        """Take the flight's generator."""
        self._rng = rng

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Draw an action."""
        space = self._space
        if isinstance(space, spaces.Discrete):
            mask = info.get("action_mask")
            known = np.arange(space.n) if mask is None else np.flatnonzero(mask)
            return space.start + np.int64(self._rng.choice(known))
        return self._rng.uniform(space.low, space.high).astype(space.dtype)


class Hover:
    """Thrust that bears the weight at the start, straight up.

    Parameters
    ----------
    env
        ``Guidance-v0`` or ``Control-v0``.

    Raises
    ------
    InputError
        If it is another.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        flown = env.unwrapped
        if not isinstance(flown, DescentEnv):
            raise refuse("hover", env, "Guidance-v0 and Control-v0")
        lanes = flown.descents.lanes
        dynamics = lanes.craft.dynamics
        weight = dynamics.lander.wet_mass * dynamics.gravity
        wanted = [0.0, 0.0, dynamics.gravity] if lanes.guided else [weight, 0.0, 0.0, 0.0]
        self._action = flown.descents.actions.action(wanted)

    def begin(self, rng: np.random.Generator) -> None:
        """Draw nothing."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the same action as ever."""
        return self._action
