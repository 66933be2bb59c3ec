"""Agents in files of Stable-Baselines3 and sb3-contrib; they need the extra ``rl`` to fly."""

from __future__ import annotations

import importlib
import json
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from lunarsim.errors import InputError

# Where a policy's class stands tells which algorithm the file is of; all of one policy act alike.
_ALGORITHMS = (
    ("sb3_contrib.common.maskable", "sb3_contrib", "MaskablePPO"),
    ("sb3_contrib.common.recurrent", "sb3_contrib", "RecurrentPPO"),
    ("stable_baselines3.sac", "stable_baselines3", "SAC"),
    ("stable_baselines3.td3", "stable_baselines3", "TD3"),
    ("stable_baselines3.dqn", "stable_baselines3", "DQN"),
    ("stable_baselines3.common", "stable_baselines3", "PPO"),
)


def _algorithm(path: Path) -> Any:
    """Return the class that loads a file.

    Raises
    ------
    InputError
        If it is none of Stable-Baselines3's, of an algorithm that is not known here, or the
        libraries are missing.
    """
    try:
        with zipfile.ZipFile(path) as file:
            policy = str(json.loads(file.read("data"))["policy_class"]["__module__"])
    except (OSError, zipfile.BadZipFile, KeyError, ValueError, TypeError, RecursionError):
        raise InputError("--agent", str(path), "a file that Stable-Baselines3 has saved") from None
    for begins, package, name in _ALGORITHMS:
        if policy.startswith(begins):
            try:
                return getattr(importlib.import_module(package), name)
            except ImportError:
                raise InputError(
                    "--agent", str(path), f"{package}, which the extra `rl` installs"
                ) from None
    known = ", ".join(name for _, _, name in _ALGORITHMS)
    raise InputError("--agent", str(path), f"one of {known}; its policy is of {policy}")


def _sizes(space: gymnasium.Space[Any]) -> Any:
    """Return what must be alike of a space for an agent of one to fly the other, for messages."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {name: _sizes(part) for name, part in sorted(space.items())}
    if isinstance(space, gymnasium.spaces.Discrete):
        return f"{type(space).__name__}({space.n})"
    if isinstance(space, gymnasium.spaces.MultiDiscrete):
        return f"{type(space).__name__}({space.nvec.tolist()})"
    return f"{type(space).__name__}{space.shape}"


def check_trust(given: str, trust_pickle: bool) -> None:
    """Refuse a file of Stable-Baselines3 that is no archive, or that the user does not trust.

    Raises
    ------
    InputError
        Naming ``--agent``.
    """
    if not zipfile.is_zipfile(given):
        raise InputError("--agent", given, "a file that Stable-Baselines3 has saved")
    if not trust_pickle:
        raise InputError(
            "--agent", given,
            "a pickle, which can run any code when it is read. Trust its source? Then add "
            "--trust-pickle (Python: trust_pickle=True); .npz files need no trust",
        )  # fmt: skip


def load_model(path: Path) -> Any:
    """Return the model of a file of Stable-Baselines3, which can run any code when it is read.

    Raises
    ------
    InputError
        See `_algorithm`.
    """
    return _algorithm(path).load(path, device="cpu")


class StoredAgent:
    """An agent that Stable-Baselines3 has saved, without exploration.

    Such a file is a pickle, which can run any code when it is read.

    Parameters
    ----------
    env
        Whose observations and actions it must have been trained on.
    path
        Of the file, ``.zip``.
    trust_pickle
        Whether the user trusts the file. It is not read otherwise.

    Raises
    ------
    InputError
        If the file will not do, or is of other spaces.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], path: Path, *, trust_pickle: bool = False
    ) -> None:
        check_trust(str(path), trust_pickle)
        self._model = load_model(path)
        for what in ("observation_space", "action_space"):
            own, others = (_sizes(getattr(one, what)) for one in (env, self._model))
            if own != others:
                raise InputError("--agent", str(path), f"one trained on {what} {own}, not {others}")
        self._masked = type(self._model).__name__ == "MaskablePPO"
        self._memory: Any = None
        self._first = True

    def begin(self, rng: np.random.Generator) -> None:
        """Forget the last flight."""
        self._memory, self._first = None, True

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the likeliest action."""
        if self._masked:
            mask = np.asarray(info["action_mask"], dtype=bool)
            return self._model.predict(observation, action_masks=mask, deterministic=True)[0]
        action, self._memory = self._model.predict(
            observation, state=self._memory, episode_start=np.array([self._first]),
            deterministic=True,
        )  # fmt: skip
        self._first = False
        return action
