"""Retargeting policies of the onboard computer as agents of ``Retarget-v0``."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from lunarsim.simulation.loop import make_policy
from lunarsim_envs.agents.contract import check_sites, refuse
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.sites.parts import SITES


class PolicyAgent:
    """A policy that decides on what the onboard computer shows it.

    A site that is none of the rows that the environment offers, and a decision to give up the
    landing, are no actions there: the lander keeps its site. A stretch of the time-to-go is none
    either: it stays as it comes.

    Parameters
    ----------
    env
        ``Retarget-v0``.
    kind
        As `lunarsim parts policy` lists it.

    Raises
    ------
    InputError
        If it is another environment, its actions choose no sites, or the policy has to be told the
        truth.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], kind: str) -> None:
        flown = env.unwrapped
        if not isinstance(flown, RetargetEnv):
            raise refuse(kind, env, "Retarget-v0")
        check_sites(kind, flown)
        self._env = flown
        self._policy = make_policy(flown.scenario, kind)
        if getattr(self._policy, "knows_truth", False):
            raise refuse(kind, env, "no environment: it has to be told the truth")

    def begin(self, rng: np.random.Generator) -> None:
        """Draw nothing: policies decide by what they see."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action of the site that the policy flies to, or keeps."""
        return self._env.actions.alone("site", self._row())

    def _row(self) -> int:
        seen = self._env.seen
        if seen is None:
            return 0
        site = self._policy.decide(seen).site
        if site is None:
            return 0
        same = np.all(seen.candidates.position[:SITES] == np.asarray(site), axis=1)
        return 1 + int(np.argmax(same)) if same.any() else 0
