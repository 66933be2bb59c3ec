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
        """Check that scores rank safe landings over crashes, and crashes over no landing.

        If that is not so for all flights, an `InputError` is raised. `propellant` is the propellant
        capacity, kg. Without penalties, a crash and no landing may have the same score.
        """
        burnt = self.propellant * propellant
        minimum = max(self.crash, self.no_landing) + burnt + self.miss * MAX_MISS_M
        if not self.safe > minimum:
            raise InputError(
                "weights.safe", self.safe,
                f"must be above {minimum:g}, otherwise another outcome may have a higher score "
                "than a safe landing",
                "This limit depends on the other keys of [descent_reward], except shaping.",
            )  # fmt: skip
        excess = self.excess * len(k.MOTION_LIMITS) * k.MAX_EXCESS
        maximum = self.crash - burnt - self.severity - excess
        if not self.no_landing <= maximum:
            raise InputError(
                "weights.no_landing", self.no_landing,
                f"must be at most {maximum:g}, otherwise a flight without touchdown may have a "
                "higher score than a crash",
                "This limit depends on the other keys of [descent_reward], except shaping.",
            )  # fmt: skip


class Rewards:
    """Compute the reward terms of every step of n descents.

    ``touchdown``, ``propellant``, ``miss``, ``severity`` and ``excess`` are the objective; their
    sum over an episode is the score. ``shaping`` is the potential after the step minus the
    potential before it. The potential is 0 after a flight has ended, so the sum over an episode is
    minus the initial potential: the undiscounted return ranks policies as the score does (Ng,
    Harada and Russell, "Policy invariance under reward transformations", ICML 1999). The potential
    falls with the deviation from a reference velocity (`_reward_kernels.reference_velocity`) and,
    near the target, with the angular rate.

    Parameters
    ----------
    weights
        Weights of the terms.
    lanes
        Batch of landers.

    Attributes
    ----------
    score
        Sum of the terms without shaping since the start of each flight (n,).
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
            float(lander.com_height),
            float(lander.thrust_max / lander.wet_mass - dynamics.gravity),
            float(lander.vertical_speed_limit),
            float(lander.horizontal_speed_limit),
            float(lander.rate_limit),
            np.array([getattr(lander, limit.limit) for limit in k.MOTION_LIMITS]),
        )
        self._mass, self._potential, self.score = np.zeros((3, lanes.count))

    def potential(self) -> Array:
        """Return the shaping potential of the current state of every lander (n,)."""
        out = np.empty(self.lanes.count)
        k.shaping_potentials(self.lanes.y, self.lanes.target, self.params, out)
        return out

    def begin(self, mask: BoolArray) -> None:
        """Store mass and potential of the flights of `mask` (n,), which have just started."""
        self._mass[mask] = self.lanes.y[mask, 13]
        self._potential[mask] = self.potential()[mask]
        self.score[mask] = 0.0

    def terms(self, moved: BoolArray) -> dict[str, Array]:
        """Return the reward terms (n,) of the last step by name.

        They are 0 for landers that were not flying before the step (`moved` (n,) is false).
        """
        lanes, terms = self.lanes, np.zeros((len(self.names), self.lanes.count))
        k.reward_terms(
            moved, lanes.y, lanes.target, lanes.ended, lanes.failed, lanes.touchdown_values,
            self.params, self._mass, self._potential, self.score, terms,
        )  # fmt: skip
        return dict(zip(self.names, terms, strict=True))
