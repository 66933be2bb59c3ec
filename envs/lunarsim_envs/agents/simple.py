"""Agents that know nothing: what they reach is what an environment gives away."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from lunarsim_envs.agents.contract import refuse
from lunarsim_envs.descent.env import DescentEnv

_SPACES = "a Box, Discrete or MultiDiscrete"


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
        elif isinstance(space, spaces.MultiDiscrete):
            self._action = space.start.copy()
        elif isinstance(space, spaces.Box):
            self._action = np.zeros(space.shape, space.dtype)
        else:
            raise refuse("zero", env, f"environments whose actions are {_SPACES}")

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
        if not isinstance(space, spaces.Discrete | spaces.MultiDiscrete | spaces.Box):
            raise refuse("random", env, f"environments whose actions are {_SPACES}")
        self._space = space
        self._rng = np.random.default_rng(0)

    def begin(self, rng: np.random.Generator) -> None:
        """Take the flight's generator."""
        self._rng = rng

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Draw an action."""
        space = self._space
        if isinstance(space, spaces.Discrete):
            return space.start + self._of(info.get("action_mask"), int(space.n))
        if isinstance(space, spaces.MultiDiscrete):
            mask, counts = info.get("action_mask"), space.nvec.tolist()
            # One mask of all numbers, those of one after those of the other.
            ends = np.cumsum(counts)[:-1]
            masks = [None] * len(counts) if mask is None else np.split(mask, ends)
            drawn = [self._of(*one) for one in zip(masks, counts, strict=True)]
            return space.start + np.array(drawn, space.dtype)
        return self._rng.uniform(space.low, space.high).astype(space.dtype)

    def _of(self, mask: Any, count: int) -> np.int64:
        """Draw one of so many, of those of a mask if there is one."""
        known = np.arange(count) if mask is None else np.flatnonzero(mask)
        return np.int64(self._rng.choice(known))


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
