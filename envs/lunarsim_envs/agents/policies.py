"""Fly ``Retarget-v1`` with the retargeting policies of the onboard computer."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from lunarsim.simulation.loop import make_policy
from lunarsim_envs.agents.agent_interface import check_sites, incompatible_agent_error
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.sites.site_inputs import SITES


class PolicyAgent:
    """Choose landing sites in ``Retarget-v1`` with an onboard retargeting policy.

    If the policy chooses a site that is not a row of the observation, or decides to abort, the
    lander keeps its site. The agent does not change the time-to-go.

    Parameters
    ----------
    env
        ``Retarget-v1``.
    kind
        Kind of policy, as listed by `lunarsim parts policy`.

    Raises
    ------
    InputError
        If the environment is another one, its actions do not include a site, or the policy needs
        the true hazard map.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], kind: str) -> None:
        flown = env.unwrapped
        if not isinstance(flown, RetargetEnv):
            raise incompatible_agent_error(kind, env, "Retarget-v1")
        check_sites(kind, flown)
        self._env = flown
        self._policy = make_policy(flown.scenario, kind)
        if getattr(self._policy, "knows_truth", False):
            raise incompatible_agent_error(
                kind, env, "the true hazard map, which environments do not provide"
            )

    def begin(self, rng: np.random.Generator) -> None:
        """Do nothing: policies have no memory and are deterministic."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action for the site that the policy chooses."""
        return self._env.actions.single_choice("site", self._row())

    def _row(self) -> int:
        seen = self._env.seen
        if seen is None:
            return 0
        site = self._policy.decide(seen).site
        if site is None:
            return 0
        same = np.all(seen.candidates.position[:SITES] == np.asarray(site), axis=1)
        return 1 + int(np.argmax(same)) if same.any() else 0
