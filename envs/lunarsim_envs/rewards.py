"""Rewards of choosing sites: the sum of named terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.scenario.rewards import SiteReward

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Choices of a flight that are not available cost no more than so many of them.
MOST_INVALID = 10


@dataclass(frozen=True)
class RewardWeights(SiteReward):
    """Weights of the terms, as the table [site_reward] of a scenario has them."""

    @classmethod
    def of(cls, scenario: Scenario) -> RewardWeights:
        """Return those of a scenario."""
        given = scenario.site_reward
        return cls() if given is None else cls(**vars(given.make()))

    def check(self) -> None:
        """Refuse weights with which a crash may return more than a safe landing.

        That is one that took all propellant, made each bad choice and touched down at all limits,
        of a map that told ever less, and a crash that burnt nothing, of one that told ever more.

        Raises
        ------
        InputError
            Naming the weight.
        """
        costs = self.propellant + MOST_INVALID * self.invalid + self.speed + self.tilt + self.hazard
        least = self.unsafe + costs + 2.0 * self.information
        if not self.safe > least:
            raise InputError(
                "weights.safe", self.safe,
                f"more than {least:g}: else a crash may return more than a landing that is safe",
            )  # fmt: skip


def touch_shares(lander: Lander, told: ArrayLike) -> Array:
    """Return how near touchdowns are to the limits (n, 3): in speed, in tilt, in the ground.

    Parameters
    ----------
    lander
        Whose limits.
    told
        Vertical and horizontal speed, tilt, rate, slope and roughness of each (n, 6), SI; NaN where
        there was no touchdown, of which the shares are NaN too.
    """
    limits = np.array([
        lander.vertical_speed_limit, lander.horizontal_speed_limit, lander.tilt_limit,
        lander.slope_limit, lander.roughness_limit,
    ])  # fmt: skip
    share = np.abs(np.asarray(told, dtype=np.float64)[:, [0, 1, 2, 4, 5]]) / limits
    ground = np.maximum(share[:, 3], share[:, 4])
    return np.column_stack((np.maximum(share[:, 0], share[:, 1]), share[:, 2], ground))


def information(p: NDArray[np.float32], seen: Mask) -> float:
    """Return what a map (rows, cols) tells, from 0, nothing, to 1, every cell for certain.

    The mean over its cells of 1 - 4 p (1 - p), 0 where nothing is seen.
    """
    return float(np.where(seen, (2.0 * p.astype(np.float64) - 1.0) ** 2, 0.0).mean())


def summed(terms: Mapping[str, Any]) -> Any:
    """Return the sum of terms, each a number or of n flights (n,).

    One after another: NumPy's own sum adds eight terms of one flight in another order than those of
    two, and Python's makes up for rounding, from 3.12 on.
    """
    total: Any = 0.0
    for term in terms.values():
        total = total + term
    return total


class SiteRewards:
    """The terms of every decision, of n flights side by side.

    All but ``shaping`` are what counts. ``shaping`` is the discount times the potential after the
    decision less that before it, and the potential is 0 once a flight has ended: over a flight its
    discounted sum is minus the potential of the first decision, whatever is chosen (Ng, Harada and
    Russell, "Policy invariance under reward transformations", ICML 1999).

    Parameters
    ----------
    weights
        Of the terms.
    propellant
        In full tanks, kg.
    count
        Of flights n.
    """

    names = (
        "touchdown", "propellant", "invalid", "speed", "tilt", "hazard", "information", "shaping",
    )  # fmt: skip

    def __init__(self, weights: RewardWeights, propellant: float, count: int) -> None:
        weights.check()
        self.weights, self._tanks = weights, propellant
        self._mass, self._potential = np.zeros(count), np.zeros(count)
        self._known, self._invalid = np.zeros(count), np.zeros(count, np.int64)

    def _sure(self, p: NDArray[np.float32], seen: Mask, of: Mask) -> Array:
        """Return what maps tell (n,); those of lanes beside `of` (n,) are as they were."""
        known = self._known.copy()
        if self.weights.information > 0.0:
            # Lane by lane: the same bits in any company.
            for i in np.flatnonzero(of):
                known[i] = information(p[i], seen[i])
        return known

    def _hope(self, p_here: Array) -> Array:
        """Return the potential of flights by the p_safe of their sites (n,); NaN: not seen."""
        return np.asarray(self.weights.shaping * np.nan_to_num(p_here, nan=0.0))

    def begin(
        self, mask: Mask, mass: Array, p_here: Array, p: NDArray[np.float32], seen: Mask
    ) -> None:
        """Note how the flights of `mask` (n,) stand at their first decision.

        Parameters
        ----------
        mask
            Which.
        mass
            True one (n,), kg.
        p_here
            p_safe of the site flown to (n,).
        p, seen
            Maps (n, rows, cols).
        """
        self._mass[mask] = mass[mask]
        self._potential[mask] = self._hope(p_here)[mask]
        self._invalid[mask] = 0
        self._known = self._sure(p, seen, mask)

    def terms(
        self, moved: Mask, invalid: Mask, over: Mask, safe: Mask, touch: Array, drawn: Mask,
        mass: Array, p_here: Array, p: NDArray[np.float32], seen: Mask,
    ) -> dict[str, Array]:  # fmt: skip
        """Return the terms of the last decision (n,) by name; 0 in flights that did not move.

        Parameters
        ----------
        moved, invalid
            Which flights moved, and which of their choices were not available (n,).
        over, safe
            Which have ended, and how (n,).
        touch
            See `touch_shares` (n, 3).
        drawn
            Whose maps may be others than before (n,).
        mass, p_here, p, seen
            See `begin`, as they stand now.
        """
        w = self.weights
        ended, landed = moved & over, moved & over & safe
        counts = moved & invalid & (self._invalid < MOST_INVALID)
        told = {name: np.zeros(len(moved)) for name in self.names}
        # What is nought in all flights is not reckoned.
        spent = -w.propellant * (self._mass - mass) / self._tanks
        told["propellant"] = np.where(moved, spent, 0.0)
        if ended.any():
            told["touchdown"] = np.where(ended, np.where(safe, w.safe, w.unsafe), 0.0)
        if counts.any():
            told["invalid"] = np.where(counts, -w.invalid, 0.0)
        if landed.any():
            near = np.where(landed[:, None], np.clip(touch, 0.0, 1.0), 0.0)
            for k, (name, weight) in enumerate(
                (("speed", w.speed), ("tilt", w.tilt), ("hazard", w.hazard))
            ):
                told[name] = -weight * near[:, k]
        if w.information > 0.0:
            known = self._sure(p, seen, moved & drawn)
            told["information"] = np.where(moved, w.information * (known - self._known), 0.0)
            self._known = known
        if w.shaping != 0.0:
            after = np.where(over, 0.0, self._hope(p_here))
            told["shaping"] = np.where(moved, w.discount * after - self._potential, 0.0)
            self._potential = np.where(moved, after, self._potential)
        self._invalid += counts
        self._mass = np.where(moved, mass, self._mass)
        return told
