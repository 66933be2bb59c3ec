"""Adapt vector environments to the interface of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from lunarsim.errors import InputError

_SHARED = "is not supported for this attribute, because all environments share one object"


def _lane_observation(shown: Any, lane: Any) -> Any:
    """Return the observation of one environment (index `lane`) from all observations."""
    if isinstance(shown, dict):
        return {name: part[lane] for name, part in shown.items()}
    return shown[lane]


class Sb3VecEnv(VecEnv):  # type: ignore[misc]
    """Present a lunarsim vector environment to Stable-Baselines3 as its `VecEnv`.

    All environments (called lanes here) step in one call, without a Python loop.

    Parameters
    ----------
    batch
        Vector environment with ``autoreset_mode="SameStep"``. For ``Retarget-v1``, the masks that
        MaskablePPO needs are available, also with several action components.

    Raises
    ------
    ValueError
        If the vector environment has another autoreset mode.
    """

    def __init__(self, batch: gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        mode = batch.metadata.get("autoreset_mode")
        if mode is not gymnasium.vector.AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode: must be AutoresetMode.SAME_STEP, got {mode}.")
        self.batch = batch
        self.render_mode = None
        super().__init__(batch.num_envs, batch.single_observation_space, batch.single_action_space)
        self._actions: NDArray[np.float32] | None = None

    def reset(self) -> Any:
        """Start new episodes in all environments; return the first observations.

        The values of `seed` and `set_options` apply.
        """
        seeds: Any = None if self._seeds[0] is None else list(self._seeds)
        pairs = self._reset_groups()
        self._reset_seeds()
        self._reset_options()
        observation, _ = self.batch.reset(seed=seeds)
        for options, lanes in pairs:
            mine = np.isin(np.arange(self.num_envs), lanes)
            observation, _ = self.batch.reset(options=options | {"reset_mask": mine})
        return observation

    def _reset_groups(self) -> list[tuple[dict[str, Any], list[int]]]:
        """Return pairs of reset options and the environments (indices) that get them."""
        given = self._options
        if len(given) != self.num_envs or not all(isinstance(one, dict) for one in given):
            raise InputError(
                "set_options",
                given,
                f"must be a dictionary, or a list of {self.num_envs} dictionaries",
            )
        alike: dict[int, list[int]] = {}
        for lane, own in enumerate(given):
            # Lanes with the same options object are reset together.
            if own:
                alike.setdefault(id(own), []).append(lane)
        return [(given[lanes[0]], lanes) for lanes in alike.values()]

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the actions (n, size) for the next call of `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Step all environments with the stored actions.

        Return observations, rewards, episode ends and infos. Only environments whose episode has
        ended have a non-empty info.
        """
        observation, reward, terminated, truncated, info = self.batch.step(self._actions)
        over = terminated | truncated
        infos: list[dict[str, Any]] = [{}] * self.num_envs
        for lane in np.flatnonzero(over):
            infos[lane] = {
                "terminal_observation": _lane_observation(info["final_obs"], lane),
                "TimeLimit.truncated": bool(truncated[lane]),
            }
            for name, kind in (("safe", bool), ("miss_m", float)):
                if name in info:
                    infos[lane][name] = kind(info[name][lane])
        return observation, reward.astype(np.float32), over, infos

    def close(self) -> None:
        """Close the vector environment."""
        self.batch.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the vector environment, once per index in `indices`."""
        value = getattr(self.batch, attr_name, None if attr_name == "render_mode" else ...)
        if value is ...:
            raise AttributeError(f"the vector environment has no attribute {attr_name!r}")
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise an `InputError`, because the environments have no separate attributes."""
        raise InputError("set_attr", attr_name, _SHARED)

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Return the action masks of the environments of `indices`.

        `method_name` must be ``action_masks``; other methods raise an `InputError`.
        """
        if method_name == "action_masks" and hasattr(self.batch, method_name):
            masks = getattr(self.batch, method_name)()
            return [masks[lane] for lane in self._get_indices(indices)]
        raise InputError("env_method", method_name, _SHARED)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False per environment, because they are not wrapped separately."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return None per environment, because vector environments do not render."""
        return [None] * self.num_envs
