"""Retargeting policies supplied with the simulator.

All candidates are eligible, so no policy selects terrain that the mission excludes. A present site
that is not eligible counts as unsafe. The policies compare sites by the log odds of safety; the
value for the mission adds to them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lunarsim.onboard.policies.contract import Decision, Observation
from lunarsim.parts.quantity import hidden, quantity


def _fly_to(observation: Observation, index: int, reason: str) -> Decision:
    """Return the decision to divert to a candidate, given by its index in the list."""
    c = observation.candidates
    return Decision(
        c.position[index],
        reason,
        {
            "p_safe": float(c.p_safe[index]),
            "distance_m": float(c.distance[index]),
            "propellant_kg": float(c.propellant[index]),
            "value": float(c.value[index]),
        },
    )


@dataclass(frozen=True)
class NoDivert:
    """Policy that never diverts from the site briefed before the flight."""

    name: str = hidden("no-divert")

    def decide(self, observation: Observation) -> Decision:
        """Return the decision to keep the site, whatever the map shows."""
        return Decision.keep("never diverts")


@dataclass(frozen=True)
class Safest:
    """Policy that diverts to the site with the highest probability of safe terrain.

    Attributes
    ----------
    hysteresis
        Minimum gain in log odds of safety for a change of site; prevents changes to and fro when
        the same terrain is observed again.
    value_weight
        Difference in log odds between sites of mission value 1 and 0. The default is below
        `hysteresis`, so that value alone does not cause a divert.
    """

    value_weight: float = quantity(
        0.5,
        ge=0,
        help="Weight of the mission value in the score of a site, which is the log odds of p_safe "
        "plus weight times value",
    )
    hysteresis: float = quantity(
        0.7,
        ge=0,
        help="Minimum improvement of a site's score for a divert, in log odds of p_safe",
    )
    name: str = hidden("safest")

    def decide(self, observation: Observation) -> Decision:
        """Return a divert to the best reachable candidate if it beats the current site.

        The score of a site is the log odds of its p_safe plus weighted mission value. The current
        site is kept if the score gains less than `hysteresis`, or if no candidate is reachable.
        """
        c = observation.candidates
        if not c.reachable.any():
            return Decision.keep("no site within reach")
        # A small cost of distance selects the nearest of equally safe sites.
        score = _log_odds(c.p_safe) + self.value_weight * c.value
        best = int(np.argmax(np.where(c.reachable, score - 1e-3 * c.distance, -np.inf)))
        present_score = (
            _log_odds(_site_p_safe(observation)) + self.value_weight * observation.site_value
        )
        if score[best] < present_score + self.hysteresis:
            return Decision.keep("no safer site")
        return _fly_to(observation, best, "safest site")


@dataclass(frozen=True)
class NearestSafe:
    """Policy that keeps a safe site, otherwise diverts to the nearest safe one.

    Attributes
    ----------
    p_safe_min
        Minimum p_safe.
    """

    p_safe_min: float = quantity(
        0.95,
        gt=0,
        lt=1,
        help="Minimum p_safe (probability of safe terrain) of a site that is accepted as safe",
    )
    name: str = hidden("nearest-safe")

    def decide(self, observation: Observation) -> Decision:
        """Return a divert to the nearest safe candidate if the current site is not safe.

        A site is safe if its p_safe is at least `p_safe_min`. Of equally near sites, the one with
        the highest value is selected. If no reachable site is safe, the policy decides as `Safest`.
        """
        if _site_p_safe(observation) >= self.p_safe_min:
            return Decision.keep("safe enough")
        c = observation.candidates
        good = c.reachable & (c.p_safe >= self.p_safe_min)
        if good.any():
            best = np.lexsort((-c.value, np.where(good, c.distance, np.inf)))[0]
            return _fly_to(observation, int(best), "nearest safe site")
        return Safest().decide(observation)


@dataclass(frozen=True)
class FuelAware:
    """Policy that weighs the probability of safety against the divert's propellant.

    The score of a site is its log odds of safety plus weighted mission value minus weighted
    propellant.

    Attributes
    ----------
    propellant_weight
        Log odds of safety that one kilogram of propellant is worth.
    hysteresis
        Minimum gain of the score for a change of site.
    value_weight
        Difference in log odds between sites of mission value 1 and 0.
    """

    value_weight: float = quantity(
        0.5,
        ge=0,
        help="Weight of the mission value in the score of a site, which is the log odds of p_safe "
        "plus weight times value",
    )
    propellant_weight: float = quantity(
        0.25,
        ge=0,
        help="Improvement in log odds of p_safe that justifies using one kilogram of propellant",
    )
    hysteresis: float = quantity(
        0.7,
        ge=0,
        help="Minimum improvement of a site's score for a divert, in log odds of p_safe",
    )
    name: str = hidden("fuel-aware")

    def decide(self, observation: Observation) -> Decision:
        """Return a divert to the reachable site with the highest score.

        The current site is kept if the score gains less than `hysteresis`.
        """
        c = observation.candidates
        if not c.reachable.any():
            return Decision.keep("no site within reach")
        score = np.where(
            c.reachable,
            _log_odds(c.p_safe)
            + self.value_weight * c.value
            - self.propellant_weight * np.minimum(c.propellant, 1e6),
            -np.inf,
        )
        best = int(np.argmax(score))
        present_score = (
            _log_odds(_site_p_safe(observation)) + self.value_weight * observation.site_value
        )
        present_score -= self.propellant_weight * observation.site_propellant
        if score[best] < present_score + self.hysteresis:
            return Decision.keep("gain too small for the propellant")
        return _fly_to(observation, best, "best value")


@dataclass(frozen=True)
class ScoreboardChoice:
    """Policy that diverts to the best site of the mapper's own ranking.

    This is the selection of the quadtree paper (section 4). It considers sites within limits of
    slope, roughness and interest, ranked by Eq. 9 of that paper; fuel is evaluated for ranked sites
    only. Sites out of reach are excluded, and the cheapest of equally ranked sites is selected. The
    paper does not specify the weight of fuel, so it is 0 by default. Fuel is that of the trajectory
    that would be flown (Eq. 10 of the paper minimised over the time-to-go), not that of the
    shortest time within limits on jerk and snap.

    Attributes
    ----------
    propellant_weight
        Score that one kilogram of propellant is worth.
    hysteresis
        Minimum gain of the score for a change of site.
    """

    propellant_weight: float = quantity(
        0.0,
        ge=0,
        help="Decrease of the mapper's site score (lowest is best) that justifies using one "
        "kilogram of propellant; 0: propellant matters only for sites with equal score",
    )
    hysteresis: float = quantity(
        0.2, ge=0, help="Minimum decrease of the mapper's site score (lowest is best) for a divert"
    )
    name: str = hidden("scoreboard")

    def decide(self, observation: Observation) -> Decision:
        """Return a divert to the reachable ranked site with the lowest cost.

        The cost is the mapper's score plus weighted propellant. The current site is kept if the
        cost decreases by less than `hysteresis`, or if no ranked site is reachable.
        """
        c = observation.candidates
        if observation.scoreboard is None:
            return Decision.keep("the mapper ranks no sites")
        good = c.reachable & np.isfinite(c.score)
        if not good.any():
            return Decision.keep("no ranked site within reach")
        cost = np.where(
            good, c.score + self.propellant_weight * np.where(good, c.propellant, 0.0), np.inf
        )
        best = int(np.lexsort((c.propellant, cost))[0])
        present_score = observation.scoreboard.current_site_score
        if np.isfinite(observation.site_propellant):
            present_score += self.propellant_weight * observation.site_propellant
        if cost[best] > present_score - self.hysteresis:
            return Decision.keep("no better ranked site")
        return _fly_to(observation, best, "best ranked site")


@dataclass(frozen=True)
class SafestOrAbort(Safest):
    """Policy that diverts to the safest site, or aborts if that is not safe enough.

    Attributes
    ----------
    p_safe_min
        p_safe below which the lander aborts.
    abort_altitude
        Estimated height of the centre of mass above the site, m. The lander can abort only below
        this height; above it, the map may still improve. Below this height, a current site out of
        reach counts as unsafe.
    """

    p_safe_min: float = quantity(
        0.5,
        ge=0,
        le=1,
        help="Minimum p_safe (probability of safe terrain) of the selected site; the lander aborts "
        "if it is lower",
    )
    abort_altitude: float = quantity(
        80.0, "m", gt=0, help="Height above the site below which the lander can abort"
    )
    name: str = hidden("safest-or-abort")

    def decide(self, observation: Observation) -> Decision:
        """Decide as `Safest`; below `abort_altitude`, abort if the chosen site is unsafe.

        A site is unsafe if its p_safe is below `p_safe_min` or unknown.
        """
        height = float(observation.estimate.position[2] - observation.site[2])
        if height > self.abort_altitude:
            return super().decide(observation)
        if np.isinf(observation.site_propellant):
            observation = replace(observation, site_p_safe=0.0)
        chosen = super().decide(observation)
        site_p_safe = _site_p_safe(observation)
        # An unobserved site is no reason to land.
        p = (
            chosen.details["p_safe"]
            if chosen.site is not None
            else np.nan_to_num(site_p_safe, nan=0.0)
        )
        if p >= self.p_safe_min:
            return chosen
        return Decision.climb_away(f"no safe site within reach: {p:.2f} at best")


def _site_p_safe(observation: Observation) -> float:
    """Return p_safe of the current site: 0 if the mission excludes it, NaN if unknown."""
    return observation.site_p_safe if observation.site_eligible else 0.0


def _log_odds(p: np.ndarray | float) -> np.ndarray:
    """Return log(p / (1 - p)) with p limited to [1e-6, 0.999]; NaN counts as unsafe.

    Beyond these limits the model error of the map exceeds the differences in p.
    """
    p = np.clip(np.nan_to_num(np.asarray(p, dtype=np.float64), nan=0.0), 1e-6, 0.999)
    return np.asarray(np.log(p / (1.0 - p)))
