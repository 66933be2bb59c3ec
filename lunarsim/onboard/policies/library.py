"""The policies that come with the simulator."""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    gain: float = quantity(0.7, ge=0, help="least gain that is worth a change, log-odds")
    name: str = hidden("safest")

    def decide(self, observation: Observation) -> Decision:
        """Pick the best reachable candidate if it beats the present site."""
        c = observation.candidates
        if not c.reachable.any():
            return Decision.keep("no site within reach")
        # Among sites that are safe beyond telling apart the nearest wins.
        score = np.where(c.reachable, _log_odds(c.p_safe) - 1e-3 * c.distance, -np.inf)
        best = int(np.argmax(score))
        if _log_odds(c.p_safe[best]) < _log_odds(observation.site_p_safe) + self.gain:
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
        """Pick the nearest reachable candidate that is safe enough, else the safest."""
        if observation.site_p_safe >= self.enough:
            return Decision.keep("safe enough")
        c = observation.candidates
        good = c.reachable & (c.p_safe >= self.enough)
        if good.any():
            return _fly_to(
                observation, int(np.argmin(np.where(good, c.distance, np.inf))), "nearest safe site"
            )
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
    """

    price: float = quantity(0.25, ge=0, help="log-odds that a kilogram is worth")
    gain: float = quantity(0.7, ge=0, help="least gain that is worth a change, log-odds")
    name: str = hidden("fuel-aware")

    def decide(self, observation: Observation) -> Decision:
        """Pick the reachable site with the best log-odds less the price of its propellant."""
        c = observation.candidates
        if not c.reachable.any():
            return Decision.keep("no site within reach")
        score = np.where(
            c.reachable, _log_odds(c.p_safe) - self.price * np.minimum(c.propellant, 1e6), -np.inf
        )
        best = int(np.argmax(score))
        stay = _log_odds(observation.site_p_safe) - self.price * observation.site_propellant
        if score[best] < stay + self.gain:
            return Decision.keep("not worth the propellant")
        return _fly_to(observation, best, "best value")


def _log_odds(p: np.ndarray | float) -> np.ndarray:
    """Return log(p / (1 - p)), NaN (unknown) counting as unsafe.

    Cut at 1e-6 and 0.999: beyond that the map's own model errors matter more than its figures.
    """
    p = np.clip(np.nan_to_num(np.asarray(p, dtype=np.float64), nan=0.0), 1e-6, 0.999)
    return np.asarray(np.log(p / (1.0 - p)))
