"""Train an agent of ``Guidance-v1`` or ``Control-v1`` by PPO, with checkpoints.

A resumed training gives bitwise the same result as an uninterrupted one. Checkpoints contain the
agent, its optimiser, the flights in progress and all random generators.
"""

from __future__ import annotations

import json
import pickle
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

from lunarsim.atomic_files import atomic_write_text
from lunarsim.errors import InputError
from lunarsim_envs.agents.network import Network
from lunarsim_envs.training.held_out import HeldOutResult, evaluate_held_out
from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv
from lunarsim_envs.training.settings import PpoSettings

# Number of flights of an evaluation.
_FLIGHTS = 300


def create_batch_env(
    settings: PpoSettings, count: int, split: str = "train"
) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    """Create the vector environment of `count` parallel flights in a split."""
    return gymnasium.make_vec(
        f"lunarsim_envs:lunarsim/{settings.environment}", num_envs=count,
        vectorization_mode="vector_entry_point", autoreset_mode="SameStep",
        rate_hz=settings.rate, changes=settings.changes, split=split,
    )  # fmt: skip


def _policy_network(model: PPO, environment: str) -> Network:
    """Convert the policy of a PPO model, trained in `environment`, to a NumPy network."""
    flown = model.get_env().batch.unwrapped.descents
    parts = tuple(part.name for part in flown.shown.parts)
    policy = model.policy
    layers = [layer for layer in policy.mlp_extractor.policy_net if hasattr(layer, "weight")]
    layers.append(policy.action_net)
    scaling = flown.scaling

    def array(tensor: torch.Tensor) -> np.ndarray[Any, np.dtype[np.float32]]:
        return np.asarray(tensor.detach().numpy(), np.float32)

    return Network(
        scaling.far, scaling.near, tuple(array(one.weight) for one in layers),
        tuple(array(one.bias) for one in layers), environment, parts, 1.0 / flown.period,
    )  # fmt: skip


class TrainingRun:
    """PPO training of an agent that flies descents, with checkpoints in a folder.

    Parameters
    ----------
    settings
        Settings of the training.
    out
        Folder of the checkpoints. A training with the same settings in this folder is continued.

    Attributes
    ----------
    done
        Number of updates of the agent so far.
    curve
        Learning curve, one row per evaluation, filled by `evaluate`.

    Raises
    ------
    InputError
        If the folder has a training with other settings.
    """

    def __init__(self, settings: PpoSettings, out: Path) -> None:
        self.settings, self.out = settings, out
        self.done = 0
        self.seconds = 0.0
        self.curve: list[dict[str, float]] = []
        out.mkdir(parents=True, exist_ok=True)
        kept = out / "settings.json"
        if kept.exists() and PpoSettings.load(kept) != settings:
            raise InputError(
                "--out",
                str(out),
                "must be a new folder, or a folder of a training with the same settings",
            )
        if (out / "checkpoint" / "state.json").exists():
            self._resume()
        else:
            settings.save(kept)
            self.model = self._new()

    def _new(self) -> PPO:
        s = self.settings
        env = Sb3VecEnv(create_batch_env(s, s.lanes))
        env.seed(s.seed)
        return PPO(
            "MlpPolicy",
            env,
            n_steps=s.horizon,
            batch_size=s.batch,
            gamma=s.discount,
            seed=s.seed,
            device="cpu",
        )

    def advance(self) -> None:
        """Fly `horizon` steps in all parallel environments and update the agent once."""
        start, s = time.perf_counter(), self.settings
        rate = s.learning_rate_at(self.done)
        self.model.lr_schedule = lambda _: rate
        self.model.learn(s.lanes * s.horizon, reset_num_timesteps=False)
        self.done += 1
        self.seconds += time.perf_counter() - start

    @property
    def network(self) -> Network:
        """NumPy network of the present agent."""
        return _policy_network(self.model, self.settings.environment)

    def fly(self, split: str, flights: int) -> HeldOutResult:
        """Evaluate the agent on flights in the worlds of a split."""
        network = self.network
        batch = create_batch_env(self.settings, flights, split)
        return evaluate_held_out(batch, lambda observation, info: network(observation))

    def evaluate(self) -> HeldOutResult:
        """Evaluate the agent in "validation"; append the result to the curve."""
        seen = self.fly("validation", _FLIGHTS)
        row: dict[str, float] = {"update": self.done, "steps": int(self.model.num_timesteps)}
        row |= {"seconds": round(self.seconds, 1), "on_target": seen.on_target}
        row |= {"safe": seen.safe, "propellant_kg": seen.propellant}
        self.curve.append(row)
        return seen

    def checkpoint(self) -> None:
        """Write a checkpoint of agent, flights and random generators to the folder.

        The previous checkpoint is kept until the new one is complete.
        """
        new, there = self.out / "checkpoint.part", self.out / "checkpoint"
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir()
        self.model.save(new / "model.zip")
        generators = {"torch": torch.get_rng_state().numpy(), "numpy": np.random.get_state()}  # noqa: NPY002
        kept = {"batch": self.model.get_env().batch, "generators": generators}
        (new / "flights.pickle").write_bytes(pickle.dumps(kept))
        state = {"done": self.done, "seconds": self.seconds, "curve": self.curve}
        atomic_write_text(new / "state.json", json.dumps(state, indent=1))
        shutil.rmtree(there, ignore_errors=True)
        new.rename(there)
        self.network.save(self.out / "agent.npz")

    def _resume(self) -> None:
        """Restore model, flights and random generators from the last checkpoint."""
        there = self.out / "checkpoint"
        kept = pickle.loads((there / "flights.pickle").read_bytes())
        self.model = PPO.load(
            there / "model.zip", env=Sb3VecEnv(kept["batch"]), device="cpu", force_reset=False
        )
        torch.set_rng_state(torch.from_numpy(kept["generators"]["torch"]))
        np.random.set_state(kept["generators"]["numpy"])  # noqa: NPY002
        state = json.loads((there / "state.json").read_text(encoding="utf-8"))
        self.done, self.seconds, self.curve = state["done"], state["seconds"], state["curve"]


def train(
    settings: PpoSettings, out: Path, interval: int,
    report: Callable[[TrainingRun, HeldOutResult], None],
) -> TrainingRun:  # fmt: skip
    """Train an agent to the end, with evaluations and checkpoints.

    Parameters
    ----------
    settings, out
        Settings and folder of the `TrainingRun`.
    interval
        Number of updates between two evaluations.
    report
        Function called after each evaluation with the run and the result.
    """
    torch.set_num_threads(1)
    run = TrainingRun(settings, out)
    while run.done < settings.updates:
        run.advance()
        if run.done % interval == 0 or run.done == settings.updates:
            seen = run.evaluate()
            run.checkpoint()
            report(run, seen)
    return run
