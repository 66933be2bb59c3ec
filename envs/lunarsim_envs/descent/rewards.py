"""Compute the rewards of a descent as a sum of named terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.core.touchdown import LIMITS, VALUES
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.rewards import DescentReward
from lunarsim.typing import Array, BoolArray
from lunarsim_envs.descent.batch import FLYING, LATE, DescentBatch
from lunarsim_envs.descent.potential import velocity_deviation as off_wanted

# Maximum miss distance in the reward, m.
MAX_MISS_M = 50.0
# Maximum severity of a crash (distance plus speed, each over that of the planned start), and
# maximum excess over a limit (natural logarithm of the ratio).
MAX_SEVERITY, MAX_EXCESS = 2.0, 3.0
# Limits of motion at touchdown, and the columns of their values.
_LIMITS = [limit for limit in LIMITS if not limit.is_terrain]
_LIMITED = [VALUES.index(limit.value) for limit in _LIMITS]


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
    with the deviation from a reference velocity (`potential.velocity_deviation`). A flight that
    reaches the time limit has not ended, so its last potential counts.

    Parameters
    ----------
    weights
        Weights of the terms.
    lanes
        Batch of landers.
    """

    names = ("touchdown", "propellant", "miss", "excess", "severity", "shaping")

    def __init__(self, weights: DescentWeights, lanes: DescentBatch) -> None:
        weights.check(lanes.craft.dynamics.lander.propellant_mass)
        self.weights, self.lanes = weights, lanes
        start = lanes.craft.start
        self._far = max(float(np.linalg.norm(start[:3])), 1.0)
        self._fast = max(float(np.linalg.norm(start[3:6])), 1.0)
        self._mass = np.zeros(lanes.count)
        self._potential = np.zeros(lanes.count)

    def _relative_distance_and_speed(self) -> Array:
        """Return distance from the target plus speed, each relative to the start (n,)."""
        y = self.lanes.y
        away = np.linalg.norm(y[:, :3] - self.lanes.target, axis=1) / self._far
        fast = np.linalg.norm(y[:, 3:6], axis=1) / self._fast
        return np.asarray(away + fast)

    def potential(self) -> Array:
        """Return the shaping potential of the current state of every lander (n,)."""
        return -self.weights.shaping * off_wanted(self.lanes)

    def _excess(self) -> Array:
        """Return by how much touchdowns exceed their limits (n,).

        It is the sum over the limits of motion (speeds, tilt, rates) of log(value / limit), or 0
        within the limit. Each logarithm is at most `MAX_EXCESS`; without a touchdown (off the
        map) each one is `MAX_EXCESS`.
        """
        vehicle = self.lanes.craft.dynamics.lander
        limits = np.array([getattr(vehicle, limit.limit) for limit in _LIMITS])
        times = np.abs(self.lanes.touchdown_values[:, _LIMITED]) / limits
        folds = np.log(np.maximum(times, 1.0))
        folds = np.where(np.isfinite(folds), np.minimum(folds, MAX_EXCESS), MAX_EXCESS)
        return np.asarray(folds.sum(axis=1))

    def begin(self, mask: BoolArray) -> None:
        """Store mass and potential of the flights of `mask` (n,), which have just started."""
        self._mass[mask] = self.lanes.y[mask, 13]
        self._potential[mask] = self.potential()[mask]

    def terms(self, moved: BoolArray) -> dict[str, Array]:
        """Return the reward terms (n,) of the last step by name.

        They are 0 for landers that were not flying before the step (`moved` (n,) is false).
        """
        w, lanes = self.weights, self.lanes
        over = (lanes.ended != FLYING) & (lanes.ended != LATE)
        after = np.where(over, 0.0, self.potential())
        rewards = {
            "propellant": -w.propellant * (self._mass - lanes.y[:, 13]),
            "shaping": w.discount * after - self._potential,
        }
        if np.any(over):
            rewards |= self._touchdown_terms(over)
        self._mass = np.where(moved, lanes.y[:, 13], self._mass)
        self._potential = np.where(moved, after, self._potential)
        nothing = np.zeros(lanes.count)
        return {name: np.where(moved, rewards.get(name, nothing), 0.0) for name in self.names}

    def _touchdown_terms(self, over: BoolArray) -> dict[str, Array]:
        """Return the touchdown, miss, excess and severity terms of each flight (n,).

        `over` (n,) marks flights that have ended by touchdown or off the map; others get 0.
        """
        w, safe = self.weights, self.lanes.safe
        severity = 0.5 * w.severity * np.minimum(self._relative_distance_and_speed(), MAX_SEVERITY)
        return {
            "touchdown": np.where(over, np.where(safe, w.safe, w.crash), 0.0),
            "miss": np.where(safe, -w.miss * np.minimum(self.lanes.miss, MAX_MISS_M), 0.0),
            "excess": np.where(over & ~safe, -w.excess * self._excess(), 0.0),
            "severity": np.where(over & ~safe, -severity, 0.0),
        }
