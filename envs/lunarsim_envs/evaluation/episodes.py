"""Episodes of one agent: everything in them derives from the root seed and the episode's index."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from lunarsim.errors import InputError
from lunarsim.rng import Streams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim_envs.agents.registry import agent_of, label


@dataclass(frozen=True)
class Study:
    """What is flown, whoever flies it.

    Attributes
    ----------
    env
        Id of the environment, ``module:`` before it where one is to be imported first.
    scenario
        Of the environment; None: as it has it.
    arguments
        Other arguments of the environment.
    seed
        Root seed of the episodes.
    trust_pickle
        Whether files of Stable-Baselines3 are trusted; see `agent_of`.
    """

    env: str
    scenario: Scenario | None
    arguments: dict[str, Any]
    seed: int
    trust_pickle: bool = False

    def make(self) -> gymnasium.Env[Any, Any]:
        """Return the environment."""
        given = dict(self.arguments)
        if self.scenario is not None:
            given["scenario"] = self.scenario
        return gymnasium.make(self.env, **given)


def _ending(info: dict[str, Any]) -> dict[str, Any]:
    """Return what an episode's last info tells: truths, numbers, and words in one text."""
    row: dict[str, Any] = {}
    for name, value in info.items():
        if isinstance(value, bool | np.bool_):
            row[name] = bool(value)
        elif isinstance(value, int | float | np.integer | np.floating):
            row[name] = float(value)
        elif isinstance(value, tuple) and all(isinstance(word, str) for word in value):
            row[name] = ", ".join(value)
    return row


def fly_episodes(study: Study, agent: str, episodes: range) -> Iterator[dict[str, Any]]:
    """Fly episodes and yield a row of each.

    Parameters
    ----------
    study, agent
        What is flown, and by whom; see `agent_of`.
    episodes
        Indices.

    Yields
    ------
    dict
        Agent, episode, return, score (the return less shaping, which tells nothing of how well it
        went), steps and sum of each term of the reward, with what the last info tells.

    Raises
    ------
    InputError
        If the agent cannot fly the environment, or gives an action that it does not take.
    """
    env = study.make()
    try:
        flies = agent_of(agent, env, trust_pickle=study.trust_pickle)
        for episode in episodes:
            streams = Streams(flight_seed(study.seed, episode))
            flies.begin(streams.get("agent"))
            seed = int(streams.get("environment").integers(2**62))
            observation, info = env.reset(seed=seed)
            total, steps, over = 0.0, 0, False
            terms: dict[str, float] = {}
            while not over:
                action = flies.act(observation, info)
                try:
                    observation, reward, ended, late, info = env.step(action)
                except ValueError as error:
                    raise InputError("--agent", agent, f"actions that fit ({error})") from error
                total, steps, over = total + float(reward), steps + 1, ended or late
                for name, term in info.get("reward_terms", {}).items():
                    terms[name] = terms.get(name, 0.0) + float(term)
            score = total - terms.get("shaping", 0.0)
            row = {"agent": label(agent), "episode": episode, "return": total, "score": score}
            row["steps"] = steps
            told = {f"reward_{name}": term for name, term in terms.items()}
            yield row | _ending(info) | {"late": bool(late and not ended)} | told
    finally:
        env.close()
