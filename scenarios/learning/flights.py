"""Fly an agent on `Retarget-v1` for the studies that compare agents."""

from __future__ import annotations

from typing import NamedTuple

import gymnasium
import numpy as np

from lunarsim import Scenario
from lunarsim_envs.agents.registry import agent_of


class AgentFlights(NamedTuple):
    """Results of one agent's flights (n,): safe landing, and propellant used (kg)."""

    safe: np.ndarray
    burnt: np.ndarray


def fly_agent(
    agent: str, scenario: Scenario, perception: str, flights: int, worlds: int, seed: int
) -> AgentFlights:
    """Fly an agent in Retarget-v1; return landing outcome and propellant per flight.

    `perception` is the source of the hazard maps, `worlds` the number of terrains and `seed` their
    root seed. Flight i has the same start for all agents, and for all perceptions that are flown by
    kernels.
    """
    env = gymnasium.make(
        "lunarsim/Retarget-v1", scenario=scenario, perception=perception, worlds=worlds,
        world_seed=seed, observation=["to_go"],
    )  # fmt: skip
    pilot = agent_of(agent, env)
    safe, burnt = np.zeros(flights, bool), np.zeros(flights)
    for k in range(flights):
        observation, info = env.reset(seed=seed + k)
        pilot.begin(np.random.default_rng(k))
        over = False
        while not over:
            observation, _, ended, late, info = env.step(pilot.act(observation, info))
            over = ended or late
        safe[k], burnt[k] = info["safe"], info["propellant_kg"]
    return AgentFlights(safe, burnt)
