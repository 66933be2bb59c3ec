"""Fly episodes of one agent, with random numbers by root seed and episode index."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from lunarsim.errors import InputError
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim_envs.agents.registry import agent_of, label


@dataclass(frozen=True)
class EvaluationStudy:
    """Definition of an evaluation of agents: environment, scenario and seed.

    Attributes
    ----------
    env
        Id of the environment, with prefix ``module:`` if a module must be imported first.
    scenario
        Scenario of the environment; None is the default of the environment.
    arguments
        Other arguments of the environment.
    seed
        Root seed of the episodes.
    trust_pickle
        Whether Stable-Baselines3 files, which can run any code, may be loaded.
    """

    env: str
    scenario: Scenario | None
    arguments: dict[str, Any]
    seed: int
    trust_pickle: bool = False

    def make(self) -> gymnasium.Env[Any, Any]:
        """Create the environment with its scenario and arguments."""
        given = dict(self.arguments)
        if self.scenario is not None:
            given["scenario"] = self.scenario
        return gymnasium.make(self.env, **given)


def _final_values(info: dict[str, Any]) -> dict[str, Any]:
    """Return the values of the last `info` that fit in a results table, by name.

    Booleans and numbers are kept, tuples of words become one text, other values are omitted. Values
    that the environment drew have the names of their scenario keys.
    """
    row: dict[str, Any] = {}
    drawn = info.get("dispersions")
    for name, value in (info | drawn if isinstance(drawn, dict) else info).items():
        if isinstance(value, bool | np.bool_):
            row[name] = bool(value)
        elif isinstance(value, int | float | np.integer | np.floating):
            row[name] = float(value)
        elif isinstance(value, tuple) and all(isinstance(word, str) for word in value):
            row[name] = ", ".join(value)
    return row


def fly_episodes(study: EvaluationStudy, agent: str, episodes: range) -> Iterator[dict[str, Any]]:
    """Fly episodes with one agent and yield the results of each episode.

    Parameters
    ----------
    study
        Definition of the evaluation.
    agent
        Agent: a name, a file or ``module:Name``, as `agent_of` accepts.
    episodes
        Indices of the episodes.

    Yields
    ------
    dict
        Name of the agent, episode, return, score (return without the term ``shaping``), steps, sum
        of each reward term, and values of the last `info`.

    Raises
    ------
    InputError
        If the agent cannot fly the environment or returns an invalid action.
    """
    env = study.make()
    try:
        flies = agent_of(agent, env, trust_pickle=study.trust_pickle)
        for episode in episodes:
            streams = RandomStreams(flight_seed(study.seed, episode))
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
                    raise InputError(
                        "--agent", agent, f"must return valid actions ({error})"
                    ) from error
                total, steps, over = total + float(reward), steps + 1, ended or late
                for name, term in info.get("reward_terms", {}).items():
                    terms[name] = terms.get(name, 0.0) + float(term)
            score = total - terms.get("shaping", 0.0)
            row = {"agent": label(agent), "episode": episode, "return": total, "score": score}
            row["steps"] = steps
            rewards = {f"reward_{name}": term for name, term in terms.items()}
            yield row | _final_values(info) | {"late": bool(late and not ended)} | rewards
    finally:
        env.close()
