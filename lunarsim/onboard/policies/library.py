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
    """Lands at the briefed site whatever the map shows."""

    name: str = hidden("no-divert")

    def decide(self, observation: Observation) -> Decision:
        """Keep the site."""
        return Decision.keep("never diverts")


@dataclass(frozen=True)
class Safest:
    """Diverts to the site with the highest probability of a safe landing.

    Attributes
    ----------
    gain
        Minimum gain in log odds of safety for a change of site; prevents changes to and fro when
        the same terrain is observed again.
    worth
        Difference in log odds between sites of value 1 and 0. The default is below `gain`, so that
        value alone does not cause a divert.
    """

    worth: float = quantity(0.5, ge=0, help="Weight of the mission value of a site in log odds")
    gain: float = quantity(0.7, ge=0, help="Minimum gain for a change of site in log odds")
    name: str = hidden("safest")

    def decide(self, observation: Observation) -> Decision:
        """Return the best reachable candidate if it beats the present site."""
        c = observation.candidates
        if not c.reachable.any():
            return Decision.keep("no site within reach")
        # A small cost of distance selects the nearest of equally safe sites.
        score = _log_odds(c.p_safe) + self.worth * c.value
        best = int(np.argmax(np.where(c.reachable, score - 1e-3 * c.distance, -np.inf)))
        present_score = (
            _log_odds(_present_p_safe(observation)) + self.worth * observation.site_value
        )
        if score[best] < present_score + self.gain:
            return Decision.keep("no safer site")
        return _fly_to(observation, best, "safest site")


@dataclass(frozen=True)
class NearestSafe:
    """Keeps the site if it is safe enough, otherwise diverts to the nearest that is.

    Attributes
    ----------
    enough
        Minimum probability of a safe landing.
    """

    enough: float = quantity(0.95, gt=0, lt=1, help="Minimum probability of a safe landing")
    name: str = hidden("nearest-safe")

    def decide(self, observation: Observation) -> Decision:
        """Return the nearest reachable candidate that is safe enough, else the safest.

        Of equally near sites, the one with the highest value is selected.
        """
        if _present_p_safe(observation) >= self.enough:
            return Decision.keep("safe enough")
        c = observation.candidates
        good = c.reachable & (c.p_safe >= self.enough)
        if good.any():
            best = np.lexsort((-c.value, np.where(good, c.distance, np.inf)))[0]
            return _fly_to(observation, int(best), "nearest safe site")
        return Safest().decide(observation)


@dataclass(frozen=True)
class FuelAware:
    """Trades the probability of safety against the propellant of the divert.

    Attributes
    ----------
    price
        Log odds of safety that one kilogram of propellant is worth.
    gain
        Minimum gain of the score for a change of site.
    worth
        Difference in log odds between sites of value 1 and 0.
    """

    worth: float = quantity(0.5, ge=0, help="Weight of the mission value of a site in log odds")
    price: float = quantity(0.25, ge=0, help="Weight of one kilogram of propellant in log odds")
    gain: float = quantity(0.7, ge=0, help="Minimum gain for a change of site in log odds")
    name: str = hidden("fuel-aware")

    def decide(self, observation: Observation) -> Decision:
        """Return the reachable site with the best log odds minus propellant cost."""
        c = observation.candidates
        if not c.reachable.any():
            return Decision.keep("no site within reach")
        score = np.where(
            c.reachable,
            _log_odds(c.p_safe) + self.worth * c.value - self.price * np.minimum(c.propellant, 1e6),
            -np.inf,
        )
        best = int(np.argmax(score))
        present_score = (
            _log_odds(_present_p_safe(observation)) + self.worth * observation.site_value
        )
        present_score -= self.price * observation.site_propellant
        if score[best] < present_score + self.gain:
            return Decision.keep("gain too small for the propellant")
        return _fly_to(observation, best, "best value")


@dataclass(frozen=True)
class ScoreboardChoice:
    """Diverts to the best site by the mapper's own ranking.

    This is the selection of the quadtree paper (section 4): sites within limits of slope, roughness
    and interest, ranked by Eq. 9; fuel is evaluated for ranked sites only. Sites out of reach are
    excluded, and the cheapest of equally ranked sites is selected. The paper does not specify the
    weight of fuel, so it is 0 by default. Fuel is that of the trajectory that would be flown (Eq.
    10 minimised over the time-to-go), not that of the shortest time within limits on jerk and snap.

    Attributes
    ----------
    weight_fuel
        Score that one kilogram of propellant is worth.
    gain
        Minimum gain of the score for a change of site.
    """

    weight_fuel: float = quantity(
        0.0, ge=0, help="Weight of one kilogram of propellant in the score"
    )
    gain: float = quantity(0.2, ge=0, help="Minimum gain of the score for a change of site")
    name: str = hidden("scoreboard")

    def decide(self, observation: Observation) -> Decision:
        """Return the reachable ranked site with the lowest score if it beats the present."""
        c = observation.candidates
        if observation.scoreboard is None:
            return Decision.keep("the mapper ranks no sites")
        good = c.reachable & np.isfinite(c.score)
        if not good.any():
            return Decision.keep("no ranked site within reach")
        cost = np.where(
            good, c.score + self.weight_fuel * np.where(good, c.propellant, 0.0), np.inf
        )
        best = int(np.lexsort((c.propellant, cost))[0])
        present_score = observation.scoreboard.here
        if np.isfinite(observation.site_propellant):
            present_score += self.weight_fuel * observation.site_propellant
        if cost[best] > present_score - self.gain:
            return Decision.keep("no better ranked site")
        return _fly_to(observation, best, "best ranked site")


@dataclass(frozen=True)
class SafestOrAbort(Safest):
    """Diverts to the safest site, and aborts if even that is not safe enough.

    Attributes
    ----------
    least
        Probability of a safe landing below which the lander aborts.
    altitude
        Estimated height of the centre of mass above the site below which an abort is allowed, m.
        Higher up, the map may still change. Below it, a site out of reach counts as unsafe.
    """

    least: float = quantity(
        0.5, ge=0, le=1, help="Probability of a safe landing below which the lander aborts"
    )
    altitude: float = quantity(
        80.0, "m", gt=0, help="Height above the site below which an abort is allowed"
    )
    name: str = hidden("safest-or-abort")

    def decide(self, observation: Observation) -> Decision:
        """Decide as `Safest`, then abort if neither site is safe enough."""
        height = float(observation.estimate.position[2] - observation.site[2])
        if height > self.altitude:
            return super().decide(observation)
        if np.isinf(observation.site_propellant):
            observation = replace(observation, site_p_safe=0.0)
        chosen = super().decide(observation)
        present_p_safe = _present_p_safe(observation)
        # An unobserved site is no reason to land.
        p = (
            chosen.details["p_safe"]
            if chosen.site is not None
            else np.nan_to_num(present_p_safe, nan=0.0)
        )
        if p >= self.least:
            return chosen
        return Decision.climb_away(f"no safe site within reach: {p:.2f} at best")


def _present_p_safe(observation: Observation) -> float:
    """Return p_safe of the present site; 0 if the mission excludes it."""
    return observation.site_p_safe if observation.site_eligible else 0.0


def _log_odds(p: np.ndarray | float) -> np.ndarray:
    """Return log(p / (1 - p)) with p limited to [1e-6, 0.999]; NaN counts as unsafe.

    Beyond these limits the model error of the map exceeds the differences in p.
    """
    p = np.clip(np.nan_to_num(np.asarray(p, dtype=np.float64), nan=0.0), 1e-6, 0.999)
    return np.asarray(np.log(p / (1.0 - p)))
