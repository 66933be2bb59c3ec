"""Fly agents saved by Stable-Baselines3 or sb3-contrib; needs the extra ``rl``."""

from __future__ import annotations

import importlib
import json
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from lunarsim.errors import InputError, missing_package

# Module of the policy class, and an algorithm that loads it. Agents with the same policy class act
# alike, so any algorithm with that policy can load the file.
_ALGORITHMS = (
    ("sb3_contrib.common.maskable", "sb3_contrib", "MaskablePPO"),
    ("sb3_contrib.common.recurrent", "sb3_contrib", "RecurrentPPO"),
    ("stable_baselines3.sac", "stable_baselines3", "SAC"),
    ("stable_baselines3.td3", "stable_baselines3", "TD3"),
    ("stable_baselines3.dqn", "stable_baselines3", "DQN"),
    ("stable_baselines3.common", "stable_baselines3", "PPO"),
)


def _algorithm(path: Path) -> Any:
    """Return the Stable-Baselines3 algorithm class that can load a saved agent.

    If the file is not from Stable-Baselines3, its algorithm is not supported, or the library is
    missing, an `InputError` is raised.
    """
    try:
        with zipfile.ZipFile(path) as file:
            policy = str(json.loads(file.read("data"))["policy_class"]["__module__"])
    except (OSError, zipfile.BadZipFile, KeyError, ValueError, TypeError, RecursionError):
        raise InputError(
            "--agent", str(path), "must be a .zip file of a model saved by Stable-Baselines3"
        ) from None
    for begins, package, name in _ALGORITHMS:
        if policy.startswith(begins):
            try:
                return getattr(importlib.import_module(package), name)
            except ImportError:
                raise missing_package("--agent", package, "rl") from None
    known = ", ".join(name for _, _, name in _ALGORITHMS)
    raise InputError(
        "--agent", str(path), f"must be trained by {known}, but its policy is from {policy}"
    )


def _space_text(space: gymnasium.Space[Any]) -> Any:
    """Return type and size of a space as text; a dictionary of texts for a Dict.

    The result serves to compare spaces and for messages.
    """
    if isinstance(space, gymnasium.spaces.Dict):
        return {name: _space_text(part) for name, part in sorted(space.items())}
    if isinstance(space, gymnasium.spaces.Discrete):
        return f"{type(space).__name__}({space.n})"
    if isinstance(space, gymnasium.spaces.MultiDiscrete):
        return f"{type(space).__name__}({space.nvec.tolist()})"
    return f"{type(space).__name__}{space.shape}"


def check_trust(file: str, trust_pickle: bool) -> None:
    """Check that a file is a Stable-Baselines3 archive and that the user trusts it.

    Raises
    ------
    InputError
        If the file is not such an archive, or `trust_pickle` is false.
    """
    if not zipfile.is_zipfile(file):
        raise InputError(
            "--agent", file, "must be a .zip file of a model saved by Stable-Baselines3"
        )
    if not trust_pickle:
        raise InputError(
            "--agent", file,
            "must be a file that you trust, because it can run any code when it is loaded",
            "If you trust it, add --trust-pickle (in Python: trust_pickle=True).",
        )  # fmt: skip


def load_model(path: Path) -> Any:
    """Load a Stable-Baselines3 model; loading can run any code in the file.

    Raises
    ------
    InputError
        If the file is not from Stable-Baselines3, its algorithm is not supported, or the library is
        missing.
    """
    return _algorithm(path).load(path, device="cpu")


class Sb3Agent:
    """Fly an agent saved by Stable-Baselines3, with its most likely actions.

    The file is a pickle, which can run any code when it is loaded.

    Parameters
    ----------
    env
        Environment with the observation and action spaces of the training.
    path
        File to load (``.zip``).
    trust_pickle
        Whether the user trusts the file. Otherwise it is refused without loading.

    Raises
    ------
    InputError
        If the file cannot be used, or was trained with other spaces.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], path: Path, *, trust_pickle: bool = False
    ) -> None:
        check_trust(str(path), trust_pickle)
        self._model = load_model(path)
        for what in ("observation", "action"):
            own, others = (_space_text(getattr(one, f"{what}_space")) for one in (env, self._model))
            if own != others:
                raise InputError(
                    "--agent", str(path),
                    f"must be trained with the {what} space of this environment, {own}, "
                    f"not {others}",
                )  # fmt: skip
        self._masked = type(self._model).__name__ == "MaskablePPO"
        self._memory: Any = None
        self._first = True

    def begin(self, rng: np.random.Generator) -> None:
        """Reset the memory of recurrent agents."""
        self._memory, self._first = None, True

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the most likely action (of the available ones, for MaskablePPO)."""
        if self._masked:
            mask = np.asarray(info["action_mask"], dtype=bool)
            return self._model.predict(observation, action_masks=mask, deterministic=True)[0]
        action, self._memory = self._model.predict(
            observation, state=self._memory, episode_start=np.array([self._first]),
            deterministic=True,
        )  # fmt: skip
        self._first = False
        return action
