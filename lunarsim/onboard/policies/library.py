"""The policies that come with the simulator.

Candidates are eligible, so none chooses ground that the mission excludes; a site flown to that is
not eligible counts as unsafe. Policies weigh safety in log-odds, and what the mission wants as so
many log-odds between ground of value 0 and of value 1.
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
    """Land where the mission said, whatever the map shows."""

    name: str = hidden("no-divert")

    def decide(self, observation: Observation) -> Decision:
        """Keep the site."""
        return Decision.keep("never diverts")


@dataclass(frozen=True)
class Safest:
    """Fly to the site with the greatest probability of a safe landing.

    Attributes
    ----------
    gain
        Least gain in log-odds of safety that is worth a change of site: a second look at the
        same ground must not send the lander to and fro.
    worth
        Log-odds of safety between ground that the mission wants (value 1) and ground that it only
        allows (value 0): less than the least gain, so that value alone sends nobody on.
    """

    worth: float = quantity(0.5, ge=0, help="of a site of value 1 over one of 0, log-odds")
    gain: float = quantity(0.7, ge=0, help="least gain that is worth a change, log-odds")
    name: str = hidden("safest")

    def decide(self, observation: Observation) -> Decision:
        """Pick the best reachable candidate if it beats the present site."""
        c = observation.candidates
        if not c.reachable.any():
            return Decision.keep("no site within reach")
        # Among sites that are safe beyond telling apart the nearest wins.
        worth = _log_odds(c.p_safe) + self.worth * c.value
        best = int(np.argmax(np.where(c.reachable, worth - 1e-3 * c.distance, -np.inf)))
        stay = _log_odds(_safe_to_stay(observation)) + self.worth * observation.site_value
        if worth[best] < stay + self.gain:
            return Decision.keep("no safer site")
        return _fly_to(observation, best, "safest site")


@dataclass(frozen=True)
class NearestSafe:
    """Keep the site if it is safe enough, else fly to the nearest one that is.

    Attributes
    ----------
    enough
        Probability that counts as safe.
    """

    enough: float = quantity(0.95, gt=0, lt=1, help="probability that counts as safe")
    name: str = hidden("nearest-safe")

    def decide(self, observation: Observation) -> Decision:
        """Pick the nearest reachable candidate that is safe enough, else the safest.

        Of sites equally near the one of the greatest value.
        """
        if _safe_to_stay(observation) >= self.enough:
            return Decision.keep("safe enough")
        c = observation.candidates
        good = c.reachable & (c.p_safe >= self.enough)
        if good.any():
            best = np.lexsort((-c.value, np.where(good, c.distance, np.inf)))[0]
            return _fly_to(observation, int(best), "nearest safe site")
        return Safest().decide(observation)


@dataclass(frozen=True)
class FuelAware:
    """Trade the probability of safety against the propellant of the divert.

    Attributes
    ----------
    price
        Log-odds of safety that one kilogram of propellant is worth.
    gain
        Least gain of the score that is worth a change of site.
    worth
        Log-odds of safety between ground of value 1 and of value 0.
    """

    worth: float = quantity(0.5, ge=0, help="of a site of value 1 over one of 0, log-odds")
    price: float = quantity(0.25, ge=0, help="log-odds that a kilogram is worth")
    gain: float = quantity(0.7, ge=0, help="least gain that is worth a change, log-odds")
    name: str = hidden("fuel-aware")

    def decide(self, observation: Observation) -> Decision:
        """Pick the reachable site with the best log-odds less the price of its propellant."""
        c = observation.candidates
        if not c.reachable.any():
            return Decision.keep("no site within reach")
        score = np.where(
            c.reachable,
            _log_odds(c.p_safe) + self.worth * c.value - self.price * np.minimum(c.propellant, 1e6),
            -np.inf,
        )
        best = int(np.argmax(score))
        stay = _log_odds(_safe_to_stay(observation)) + self.worth * observation.site_value
        stay -= self.price * observation.site_propellant
        if score[best] < stay + self.gain:
            return Decision.keep("not worth the propellant")
        return _fly_to(observation, best, "best value")


@dataclass(frozen=True)
class ScoreboardChoice:
    """Fly to the best site that the mapper has ranked itself, by its own score.

    The choice of the quadtree paper (section 4): sites within slope, roughness and interest limits,
    ranked by Eq. 9; fuel is looked at for ranked sites alone. A site out of reach is left out, and
    of sites of one score the cheapest wins; the paper says no more of how fuel counts: its weight
    is nought unless it is given one. The fuel is that of the trajectory that would be flown (Eq. 10
    minimised over the time-to-go), not of the least time within limits on jerk and snap.

    Attributes
    ----------
    weight_fuel
        Score that one kilogram of propellant is worth.
    gain
        Least gain of the score that is worth a change of site.
    """

    weight_fuel: float = quantity(0.0, ge=0, help="score that a kilogram is worth")
    gain: float = quantity(0.2, ge=0, help="least gain of the score that is worth a change")
    name: str = hidden("scoreboard")

    def decide(self, observation: Observation) -> Decision:
        """Pick the reachable ranked site of the least score if it beats the present one."""
        c = observation.candidates
        if observation.scoreboard is None:
            return Decision.keep("the map ranks no sites")
        good = c.reachable & np.isfinite(c.score)
        if not good.any():
            return Decision.keep("no ranked site within reach")
        cost = np.where(
            good, c.score + self.weight_fuel * np.where(good, c.propellant, 0.0), np.inf
        )
        best = int(np.lexsort((c.propellant, cost))[0])
        stay = observation.scoreboard.here
        if np.isfinite(observation.site_propellant):
            stay += self.weight_fuel * observation.site_propellant
        if cost[best] > stay - self.gain:
            return Decision.keep("no better site on the board")
        return _fly_to(observation, best, "best of the scoreboard")


@dataclass(frozen=True)
class SafestOrAbort(Safest):
    """Fly to the safest site, and climb away if even that is not safe enough.

    Attributes
    ----------
    least
        Probability of a safe landing below which the lander climbs away.
    altitude
        Estimated height of the centre of mass above the site under which it does so, m: above, the
        map may still change. A site out of reach counts as none from there on.
    """

    least: float = quantity(0.5, ge=0, le=1, help="probability below which it climbs away")
    altitude: float = quantity(80.0, "m", gt=0, help="above the site, under which it does so")
    name: str = hidden("safest-or-abort")

    def decide(self, observation: Observation) -> Decision:
        """Decide as `Safest`, then abort if neither that site nor the present one will do."""
        height = float(observation.estimate.position[2] - observation.site[2])
        if height > self.altitude:
            return super().decide(observation)
        if np.isinf(observation.site_propellant):
            observation = replace(observation, site_p_safe=0.0)
        chosen = super().decide(observation)
        stay = _safe_to_stay(observation)
        # A site that nobody has looked at is no reason to land there.
        p = chosen.details["p_safe"] if chosen.site is not None else np.nan_to_num(stay, nan=0.0)
        if p >= self.least:
            return chosen
        return Decision.climb_away(f"no safe site within reach: {p:.2f} at best")


def _safe_to_stay(observation: Observation) -> float:
    """Return the probability of safety at the site flown to; 0 where the mission excludes it."""
    return observation.site_p_safe if observation.site_eligible else 0.0


def _log_odds(p: np.ndarray | float) -> np.ndarray:
    """Return log(p / (1 - p)), NaN (unknown) counting as unsafe.

    Cut at 1e-6 and 0.999: beyond that the map's own model errors matter more than its figures.
    """
    p = np.clip(np.nan_to_num(np.asarray(p, dtype=np.float64), nan=0.0), 1e-6, 0.999)
    return np.asarray(np.log(p / (1.0 - p)))
