"""Rewards of a descent: the sum of named terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.rewards import DescentReward
from lunarsim_envs.descent.lanes import FLYING, LATE, Lanes
from lunarsim_envs.descent.potential import off as off_wanted

Array = NDArray[np.float64]

# A landing farther from its target than this counts as this far, m.
MOST_MISS = 50.0
# No crash is told to be worse than distance and speed of the planned start together, nor to exceed
# a limit by more e-folds.
MOST_SEVERITY, MOST_EXCESS = 2.0, 3.0
# Speeds down and along the ground, tilt and rate: those of `Lanes.told` that have such a limit.
_LIMITED = 4


@dataclass(frozen=True)
class DescentWeights(DescentReward):
    """Weights of the terms, as the table [descent_reward] of a scenario has them."""

    @classmethod
    def of(cls, scenario: Scenario) -> DescentWeights:
        """Return those of a scenario."""
        given = scenario.descent_reward
        return cls() if given is None else cls(**vars(given.make()))

    def check(self, propellant: float) -> None:
        """Refuse weights with which a crash may return more than a safe landing.

        Parameters
        ----------
        propellant
            In full tanks, kg.

        Raises
        ------
        InputError
            Naming the weight.
        """
        least = self.crash + self.propellant * propellant + self.miss * MOST_MISS
        if not self.safe > least:
            raise InputError(
                "weights.safe", self.safe,
                f"more than {least:g}: else a crash may return more than a landing that is safe "
                f"but far off and took all propellant",
            )  # fmt: skip


class Rewards:
    """The terms of every step.

    ``touchdown``, ``propellant``, ``miss``, ``severity`` and ``excess`` are what counts.
    ``shaping`` is the discount times the potential after the step less that before it, and the
    potential is 0 once a flight has ended: over an episode its discounted sum is minus the
    potential of the start, whatever is done, so it changes no policy's place among others (Ng,
    Harada and Russell, "Policy invariance under reward transformations", ICML 1999). The potential
    falls with how far the velocity is off one that leads to the target (see `potential.off`). A
    flight that is broken off by the time limit has not ended: its last potential counts.

    Parameters
    ----------
    weights
        Of the terms.
    lanes
        Whose flights.
    """

    names = ("touchdown", "propellant", "miss", "severity", "excess", "shaping")

    def __init__(self, weights: DescentWeights, lanes: Lanes) -> None:
        weights.check(lanes.craft.dynamics.lander.propellant_mass)
        self.weights, self.lanes = weights, lanes
        start = lanes.craft.start
        self._far = max(float(np.linalg.norm(start[:3])), 1.0)
        self._fast = max(float(np.linalg.norm(start[3:6])), 1.0)
        self._mass = np.zeros(lanes.count)
        self._potential = np.zeros(lanes.count)

    def _off(self) -> Array:
        """Return distance and speed of every lane, each over the planned start's, summed (n,)."""
        y = self.lanes.y
        away = np.linalg.norm(y[:, :3] - self.lanes.target, axis=1) / self._far
        fast = np.linalg.norm(y[:, 3:6], axis=1) / self._fast
        return np.asarray(away + fast)

    def potential(self) -> Array:
        """Return the potential of every lane as it stands (n,), flown to an end or not."""
        return -self.weights.shaping * off_wanted(self.lanes)

    def _excess(self) -> Array:
        """Return by how many e-folds each touchdown exceeds its limits, summed (n,)."""
        vehicle = self.lanes.craft.dynamics.lander
        limits = np.array([
            vehicle.vertical_speed_limit, vehicle.horizontal_speed_limit, vehicle.tilt_limit,
            vehicle.rate_limit,
        ])  # fmt: skip
        times = np.abs(self.lanes.told[:, :_LIMITED]) / limits
        folds = np.log(np.maximum(times, 1.0))
        folds = np.where(np.isfinite(folds), np.minimum(folds, MOST_EXCESS), MOST_EXCESS)
        return np.asarray(folds.sum(axis=1))

    def begin(self, mask: NDArray[np.bool_]) -> None:
        """Note how the lanes of `mask` begin."""
        self._mass[mask] = self.lanes.y[mask, 13]
        self._potential[mask] = self.potential()[mask]

    def terms(self, moved: NDArray[np.bool_]) -> dict[str, Array]:
        """Return the terms of the last step (n,) by name; 0 in lanes that did not move."""
        w, lanes = self.weights, self.lanes
        over = (lanes.ended != FLYING) & (lanes.ended != LATE)
        after = np.where(over, 0.0, self.potential())
        safe = lanes.safe
        severity = 0.5 * w.severity * np.minimum(self._off(), MOST_SEVERITY)
        told = {
            "touchdown": np.where(over, np.where(safe, w.safe, w.crash), 0.0),
            "propellant": -w.propellant * (self._mass - lanes.y[:, 13]),
            "miss": np.where(safe, -w.miss * np.minimum(lanes.miss, MOST_MISS), 0.0),
            "excess": np.where(over & ~safe, -w.excess * self._excess(), 0.0),
            "severity": np.where(over & ~safe, -severity, 0.0),
            "shaping": w.discount * after - self._potential,
        }
        self._mass = np.where(moved, lanes.y[:, 13], self._mass)
        self._potential = np.where(moved, after, self._potential)
        return {name: np.where(moved, term, 0.0) for name, term in told.items()}
