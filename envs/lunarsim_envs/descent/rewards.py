"""Compute the rewards of a descent as a sum of named terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.rewards import DescentReward
from lunarsim.typing import Array, BoolArray
from lunarsim_envs.descent import _reward_kernels as k
from lunarsim_envs.descent.batch import DescentBatch

MAX_MISS_M = k.MAX_MISS_M


@dataclass(frozen=True)
class DescentWeights(DescentReward):
    """Weights of the reward terms of descents, as in the table [descent_reward]."""

    @classmethod
    def of(cls, scenario: Scenario) -> DescentWeights:
        """Return the weights in the table [descent_reward] of a scenario, or the defaults."""
        given = scenario.descent_reward
        return cls() if given is None else cls(**vars(given.make()))

    def check(self, propellant: float) -> None:
        """Check that every safe landing returns more than any crash, apart from shaping.

        If the weight ``safe`` is too small for that, an `InputError` is raised. `propellant` is the
        propellant capacity, kg.
        """
        minimum = self.crash + self.propellant * propellant + self.miss * MAX_MISS_M
        if not self.safe > minimum:
            raise InputError(
                "weights.safe", self.safe,
                f"must be above {minimum:g}, otherwise a crash may have a higher total reward "
                "than a safe landing",
                "This limit depends on the keys crash, propellant and miss of [descent_reward].",
            )  # fmt: skip


class Rewards:
    """Compute the reward terms of every step of n descents.

    ``touchdown``, ``propellant``, ``miss``, ``severity`` and ``excess`` are the objective.
    ``shaping`` is the discount factor times the potential after the step minus the potential
    before it. The potential is 0 after a flight has ended; the discounted sum over an episode is
    therefore minus the initial potential, which does not change the ranking of policies (Ng, Harada
    and Russell, "Policy invariance under reward transformations", ICML 1999). The potential falls
    with the deviation from a reference velocity (`_reward_kernels.reference_velocity`). A flight
    that reaches the time limit has not ended, so its last potential counts.

    Parameters
    ----------
    weights
        Weights of the terms.
    lanes
        Batch of landers.
    """

    names = k.TERMS

    def __init__(self, weights: DescentWeights, lanes: DescentBatch) -> None:
        dynamics, start = lanes.craft.dynamics, lanes.craft.start
        lander = dynamics.lander
        weights.check(lander.propellant_mass)
        self.weights, self.lanes = weights, lanes
        self.params = k.RewardParams(
            k.Weights(**{name: float(weight) for name, weight in vars(weights).items()}),
            max(float(np.linalg.norm(start[:3])), 1.0),
            max(float(np.linalg.norm(start[3:6])), 1.0),
            float(lander.com_height),
            float(lander.thrust_max / lander.wet_mass - dynamics.gravity),
            float(lander.vertical_speed_limit),
            float(lander.horizontal_speed_limit),
            np.array([getattr(lander, limit.limit) for limit in k.MOTION_LIMITS]),
        )
        self._mass, self._potential = np.zeros((2, lanes.count))

    def potential(self) -> Array:
        """Return the shaping potential of the current state of every lander (n,)."""
        out = np.empty(self.lanes.count)
        k.shaping_potentials(self.lanes.y, self.lanes.target, self.params, out)
        return out

    def begin(self, mask: BoolArray) -> None:
        """Store mass and potential of the flights of `mask` (n,), which have just started."""
        self._mass[mask] = self.lanes.y[mask, 13]
        self._potential[mask] = self.potential()[mask]

    def terms(self, moved: BoolArray) -> dict[str, Array]:
        """Return the reward terms (n,) of the last step by name.

        They are 0 for landers that were not flying before the step (`moved` (n,) is false).
        """
        lanes, terms = self.lanes, np.zeros((len(self.names), self.lanes.count))
        k.reward_terms(
            moved, lanes.y, lanes.target, lanes.ended, lanes.failed, lanes.touchdown_values,
            self.params, self._mass, self._potential, terms,
        )  # fmt: skip
        return dict(zip(self.names, terms, strict=True))
