"""Evaluate an agent on flights that its training does not use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

# Agent of a batch: function of observations and info that returns the actions.
BatchAgent = Callable[[Any, dict[str, Any]], Any]


@dataclass(frozen=True)
class HeldOutResult:
    """Result of an evaluation of an agent on flights that the training does not use.

    Attributes
    ----------
    safe, on_target
        Fraction of safe landings, and of safe landings within 10 m of the target; the second is NaN
        in environments whose target can change, and if no flight ends.
    propellant
        Mean propellant of safe landings, kg; NaN if there are none.
    """

    safe: float
    on_target: float
    propellant: float


def evaluate_held_out(
    batch: gymnasium.vector.VectorEnv[Any, Any, Any], agent: BatchAgent, seed: int = 10**9
) -> HeldOutResult:
    """Fly one episode in each environment of a batch.

    Parameters
    ----------
    batch
        Vector environment with the autoreset mode "SameStep". A truncated flight counts as one
        without a safe landing.
    agent
        Function of observations and info that returns the actions.
    seed
        Seed of the episodes.
    """
    observation, info = batch.reset(seed=seed)
    waiting = np.ones(batch.num_envs, np.bool_)
    safe, burnt = np.zeros((2, batch.num_envs))
    miss, has_miss = np.full(batch.num_envs, np.inf), False
    while waiting.any():
        observation, _, ended, late, info = batch.step(agent(observation, info))
        new = (ended | late) & waiting
        landed = new & ended
        if landed.any():
            safe[landed], burnt[landed] = info["safe"][landed], info["propellant_kg"][landed]
            if "miss_m" in info:
                miss[landed], has_miss = info["miss_m"][landed], True
        waiting &= ~new
    good = safe > 0.0
    on_target = float((good & (miss <= 10.0)).mean()) if has_miss else float("nan")
    spent = float(burnt[good].mean()) if good.any() else float("nan")
    return HeldOutResult(float(good.mean()), on_target, spent)
