"""Compute the rewards of ``Retarget-v1`` as a sum of named terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.core.touchdown import VALUES
from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.scenario.rewards import SiteReward
from lunarsim.typing import Array, BoolArray

# Maximum number of invalid choices per flight that are penalised.
MAX_PENALISED_CHOICES = 10


@dataclass(frozen=True)
class RewardWeights(SiteReward):
    """Weights of the reward terms of ``Retarget-v1``, as in the table [site_reward]."""

    @classmethod
    def of(cls, scenario: Scenario) -> RewardWeights:
        """Return the weights in the table [site_reward] of a scenario, or the defaults."""
        given = scenario.site_reward
        return cls() if given is None else cls(**vars(given.make()))

    def check(self) -> None:
        """Check that every safe landing returns more than any crash, apart from shaping.

        The worst safe landing uses all propellant, makes the maximum number of invalid choices,
        touches down at all limits and loses all map information. The best crash uses no propellant
        and gains all map information.

        Raises
        ------
        InputError
            If the weight ``safe`` is too small for that.
        """
        costs = (
            self.propellant
            + MAX_PENALISED_CHOICES * self.invalid
            + self.speed
            + self.tilt
            + self.hazard
        )
        minimum = self.unsafe + costs + 2.0 * self.information
        if not self.safe > minimum:
            raise InputError(
                "weights.safe", self.safe,
                f"must be above {minimum:g}, otherwise a crash may have a higher total reward "
                "than a safe landing",
                "This limit depends on the other keys of [site_reward], except shaping.",
            )  # fmt: skip


def touchdown_limit_ratios(lander: Lander, touchdown: ArrayLike) -> Array:
    """Return touchdown speed, tilt and terrain relative to their limits (n, 3).

    The speed ratio is the larger of vertical and horizontal speed over its limit; the terrain ratio
    is the larger of slope and roughness over its limit.

    Parameters
    ----------
    lander
        Vehicle with the limits.
    touchdown
        Values at touchdown (n, values) in the order of `core.touchdown.VALUES`, SI. Rows of NaN (no
        touchdown) give NaN.
    """
    values = np.abs(np.asarray(touchdown, dtype=np.float64))

    def ratio(value: str, limit: str) -> Array:
        """Return a value (n,) relative to its limit."""
        return np.asarray(values[:, VALUES.index(value)] / getattr(lander, limit))

    speeds = (
        ratio("vertical_speed", "vertical_speed_limit"),
        ratio("horizontal_speed", "horizontal_speed_limit"),
    )
    terrain = ratio("slope", "slope_limit"), ratio("roughness", "roughness_limit")
    return np.column_stack((np.maximum(*speeds), ratio("tilt", "tilt_limit"), np.maximum(*terrain)))


def map_information(p: NDArray[np.float32], observed: BoolArray) -> float:
    """Return how certain a hazard map is, from 0 (unknown) to 1 (all cells certain).

    `p` (rows, cols) is the probability of safe terrain and `observed` (rows, cols) marks observed
    cells. The result is the mean over all cells of 1 - 4 p (1 - p), with 0 for unobserved cells.
    """
    return float(np.where(observed, (2.0 * p.astype(np.float64) - 1.0) ** 2, 0.0).mean())


def sum_terms(terms: Mapping[str, Any]) -> Any:
    """Return the sum of the reward terms in a mapping, each a number or an array (n,).

    Terms are added in a fixed order. The order of NumPy's sum depends on the number of flights, and
    Python's `sum` compensates rounding since version 3.12.
    """
    total: Any = 0.0
    for term in terms.values():
        total = total + term
    return total


class SiteRewards:
    """Compute the reward terms of every site decision of n flights.

    All terms except ``shaping`` are the objective; their sum over an episode is the score.
    ``shaping`` is the potential after the decision minus the potential before it. The potential is
    0 after a flight has ended; the sum over an episode is therefore minus the potential of the
    first decision, whatever the agent chooses (Ng, Harada and Russell, "Policy invariance under
    reward transformations", ICML 1999).

    Parameters
    ----------
    weights
        Weights of the terms.
    propellant
        Propellant capacity, kg.
    count
        Number of flights n.

    Attributes
    ----------
    score
        Sum of the terms without shaping since the first decision of each flight (n,).
    """

    names = (
        "touchdown", "propellant", "invalid", "speed", "tilt", "hazard", "information", "shaping",
    )  # fmt: skip

    def __init__(self, weights: RewardWeights, propellant: float, count: int) -> None:
        weights.check()
        self.weights, self._tanks = weights, propellant
        self._mass, self._potential, self.score = np.zeros((3, count))
        self._known, self._invalid = np.zeros(count), np.zeros(count, np.int64)

    def _map_information(
        self, p: NDArray[np.float32], seen: BoolArray, changed: BoolArray
    ) -> Array:
        """Return `map_information` of all flights (n,), updated where `changed` is true.

        `p` and `seen` are the maps of p_safe and of observed cells (n, rows, cols). If the weight
        of the term ``information`` is zero, the stored values are returned.
        """
        known = self._known.copy()
        if self.weights.information > 0.0:
            # Computed per lane, so that results do not depend on the batch.
            for i in np.flatnonzero(changed):
                known[i] = map_information(p[i], seen[i])
        return known

    def _site_potential(self, p_here: Array) -> Array:
        """Return the shaping potential (n,) for p_safe of the current site (n,).

        An unobserved site (NaN) counts as 0.
        """
        return np.asarray(self.weights.shaping * np.nan_to_num(p_here, nan=0.0))

    def begin(
        self, mask: BoolArray, mass: Array, p_here: Array, p: NDArray[np.float32], seen: BoolArray
    ) -> None:
        """Store the values at the first decision, from which later rewards are computed.

        Parameters
        ----------
        mask
            Flights that start (n,).
        mass
            True mass (n,), kg.
        p_here
            p_safe (probability of safe terrain) of the current site (n,).
        p, seen
            Maps of p_safe and of observed cells (n, rows, cols).
        """
        self._mass[mask] = mass[mask]
        self._potential[mask] = self._site_potential(p_here)[mask]
        self._invalid[mask] = 0
        self.score[mask] = 0.0
        self._known = self._map_information(p, seen, mask)

    def terms(
        self, moved: BoolArray, invalid: BoolArray, over: BoolArray, safe: BoolArray,
        touchdown_ratios: Array, map_changed: BoolArray, mass: Array, p_here: Array,
        p: NDArray[np.float32], seen: BoolArray,
    ) -> dict[str, Array]:  # fmt: skip
        """Return the reward terms (n,) of the last decision by name.

        Parameters
        ----------
        moved, invalid
            Flights that were in progress at the last decision (others get 0), and flights whose
            chosen site was not available (n,).
        over, safe
            Flights that have ended, and flights that landed safely (n,).
        touchdown_ratios
            Touchdown speed, tilt and terrain over their limits (n, 3), from
            `touchdown_limit_ratios`.
        map_changed
            Flights whose maps may have changed (n,).
        mass, p_here, p, seen
            Current values of the arguments of `begin`.
        """
        w = self.weights
        ended, landed = moved & over, moved & over & safe
        counts = moved & invalid & (self._invalid < MAX_PENALISED_CHOICES)
        terms = {name: np.zeros(len(moved)) for name in self.names}
        # Terms that are zero for all flights are skipped.
        spent = -w.propellant * (self._mass - mass) / self._tanks
        terms["propellant"] = np.where(moved, spent, 0.0)
        if ended.any():
            terms["touchdown"] = np.where(ended, np.where(safe, w.safe, w.unsafe), 0.0)
        if counts.any():
            terms["invalid"] = np.where(counts, -w.invalid, 0.0)
        if landed.any():
            near = np.where(landed[:, None], np.clip(touchdown_ratios, 0.0, 1.0), 0.0)
            for k, (name, weight) in enumerate(
                (("speed", w.speed), ("tilt", w.tilt), ("hazard", w.hazard))
            ):
                terms[name] = -weight * near[:, k]
        if w.information > 0.0:
            known = self._map_information(p, seen, moved & map_changed)
            terms["information"] = np.where(moved, w.information * (known - self._known), 0.0)
            self._known = known
        if w.shaping != 0.0:
            after = np.where(over, 0.0, self._site_potential(p_here))
            terms["shaping"] = np.where(moved, after - self._potential, 0.0)
            self._potential = np.where(moved, after, self._potential)
        self.score += sum_terms({name: terms[name] for name in self.names[:-1]})
        self._invalid += counts
        self._mass = np.where(moved, mass, self._mass)
        return terms
