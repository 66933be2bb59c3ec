"""A native batch as Stable-Baselines3 takes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from lunarsim.errors import InputError

_SHARED = "a change of the batch itself: its lanes share all that they are"


def _of(shown: Any, lane: Any) -> Any:
    """Return what one lane is shown."""
    if isinstance(shown, dict):
        return {name: part[lane] for name, part in shown.items()}
    return shown[lane]


class LanesVecEnv(VecEnv):  # type: ignore[misc]
    """Lanes of a native batch; nothing here goes through lanes one by one.

    Parameters
    ----------
    batch
        Of any of the environments, with ``autoreset_mode="SameStep"``. One of ``Retarget-v0`` has
        the masks that MaskablePPO asks for, also of actions of several parts.
    starts
        Options of a reset, each for an equal share of the lanes, in their order; left out: all
        lanes start as the scenario says.

    Raises
    ------
    ValueError
        If it resets its lanes otherwise.
    """

    def __init__(
        self, batch: gymnasium.vector.VectorEnv[Any, Any, Any],
        starts: Sequence[dict[str, Any]] = (),
    ) -> None:  # fmt: skip
        mode = batch.metadata.get("autoreset_mode")
        if mode is not gymnasium.vector.AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode = {mode}: must be 'SameStep'")
        self.batch, self.starts = batch, tuple(starts)
        self.render_mode = None
        super().__init__(batch.num_envs, batch.single_observation_space, batch.single_action_space)
        self._actions: NDArray[np.float32] | None = None

    def reset(self) -> Any:
        """Begin new flights in all lanes: with what `seed` and `set_options` said before."""
        seeds: Any = None if self._seeds[0] is None else list(self._seeds)
        told = self._told()
        self._reset_seeds()
        self._reset_options()
        observation, _ = self.batch.reset(seed=seeds)
        for options, lanes in told:
            mine = np.isin(np.arange(self.num_envs), lanes)
            observation, _ = self.batch.reset(options=options | {"reset_mask": mine})
        return observation

    def _told(self) -> list[tuple[dict[str, Any], list[int]]]:
        """Return options of a reset, those of `set_options` over `starts`, and lanes of each."""
        given = self._options
        if len(given) != self.num_envs or not all(isinstance(one, dict) for one in given):
            raise InputError("set_options", given, f"options by name, or {self.num_envs} of such")
        alike: dict[tuple[int, int], list[int]] = {}
        for lane, own in enumerate(given):
            # One set of options for all lanes is one object; those without any go together too.
            key = lane * len(self.starts) // self.num_envs, id(own) if own else 0
            alike.setdefault(key, []).append(lane)
        told = []
        for (start, _), lanes in alike.items():
            options = (self.starts[start] if self.starts else {}) | self._options[lanes[0]]
            if self.starts or options:
                told.append((options, lanes))
        return told

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Note the actions (n, size)."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Fly on; only lanes whose flight has ended have something to tell beside."""
        observation, reward, terminated, truncated, info = self.batch.step(self._actions)
        over = terminated | truncated
        told: list[dict[str, Any]] = [{}] * self.num_envs
        for lane in np.flatnonzero(over):
            told[lane] = {
                "terminal_observation": _of(info["final_obs"], lane),
                "TimeLimit.truncated": bool(truncated[lane]),
                "safe": bool(info["safe"][lane]),
            }
            if "miss_m" in info:
                told[lane]["miss_m"] = float(info["miss_m"][lane])
        return observation, reward.astype(np.float32), over, told

    def close(self) -> None:
        """Close the batch."""
        self.batch.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the batch, once for each lane."""
        value = getattr(self.batch, attr_name, None if attr_name == "render_mode" else ...)
        if value is ...:
            raise AttributeError(attr_name)
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse, with an `InputError`: lanes have nothing of their own."""
        raise InputError("set_attr", attr_name, _SHARED)

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Return the masks of actions of lanes; refuse others, with an `InputError`."""
        if method_name == "action_masks" and hasattr(self.batch, method_name):
            masks = getattr(self.batch, method_name)()
            return [masks[lane] for lane in self._get_indices(indices)]
        raise InputError("env_method", method_name, _SHARED)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return false, once for each lane."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return none: a batch draws nothing."""
        return [None] * self.num_envs
