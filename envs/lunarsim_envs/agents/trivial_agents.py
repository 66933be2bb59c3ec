"""Trivial agents, whose scores are a lower reference for other agents."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from lunarsim_envs.agents.agent_interface import incompatible_agent_error
from lunarsim_envs.descent.env import DescentEnv

_SPACES = "Box, Discrete or MultiDiscrete"


class ZeroAgent:
    """Always return zeros, or the first option of a discrete action.

    Parameters
    ----------
    env
        Environment with Box, Discrete or MultiDiscrete actions.
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
            raise incompatible_agent_error("zero", env, f"an action space of type {_SPACES}")

    def begin(self, rng: np.random.Generator) -> None:
        """Do nothing: the action is constant."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the constant action."""
        return self._action


class RandomAgent:
    """Return uniformly distributed actions, restricted to available options.

    Parameters
    ----------
    env
        Environment with Box, Discrete or MultiDiscrete actions.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        space = env.action_space
        if not isinstance(space, spaces.Discrete | spaces.MultiDiscrete | spaces.Box):
            raise incompatible_agent_error("random", env, f"an action space of type {_SPACES}")
        self._space = space
        self._rng = np.random.default_rng(0)

    def begin(self, rng: np.random.Generator) -> None:
        """Use `rng` for the actions of the next episode."""
        self._rng = rng

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Sample an action at random, from the available ones by ``info["action_mask"]``."""
        space = self._space
        if isinstance(space, spaces.Discrete):
            return space.start + self._sample_option(info.get("action_mask"), int(space.n))
        if isinstance(space, spaces.MultiDiscrete):
            mask, counts = info.get("action_mask"), space.nvec.tolist()
            # The mask concatenates the masks of all choices.
            ends = np.cumsum(counts)[:-1]
            masks = [None] * len(counts) if mask is None else np.split(mask, ends)
            drawn = [self._sample_option(*one) for one in zip(masks, counts, strict=True)]
            return space.start + np.array(drawn, space.dtype)
        return self._rng.uniform(space.low, space.high).astype(space.dtype)

    def _sample_option(self, mask: Any, count: int) -> np.int64:
        """Sample one of `count` options at random; a mask (count,) restricts the options."""
        known = np.arange(count) if mask is None else np.flatnonzero(mask)
        return np.int64(self._rng.choice(known))


class HoverAgent:
    """Command a constant vertical thrust equal to the initial weight.

    Parameters
    ----------
    env
        ``Guidance-v1`` or ``Control-v1``.

    Raises
    ------
    InputError
        If the environment is another one.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        flown = env.unwrapped
        if not isinstance(flown, DescentEnv):
            raise incompatible_agent_error("hover", env, "Guidance-v1 or Control-v1")
        lanes = flown.descents.lanes
        dynamics = lanes.craft.dynamics
        weight = dynamics.lander.wet_mass * dynamics.gravity
        wanted = [0.0, 0.0, dynamics.gravity] if lanes.guided else [weight, 0.0, 0.0, 0.0]
        self._action = flown.descents.actions.action(wanted)

    def begin(self, rng: np.random.Generator) -> None:
        """Do nothing: the action is constant."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the constant action."""
        return self._action
