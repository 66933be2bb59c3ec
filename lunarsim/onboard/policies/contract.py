"""What a policy sees and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Candidates:
    """Landing sites worth a look, best first; the site flown to now is not among them.

    Attributes
    ----------
    position
        Estimated ENU (n, 3), m; the third is the ground's elevation.
    p_safe
        Probability of landing safely when aiming there (n,).
    distance
        Distance over the ground from the site flown to now (n,), m.
    propellant
        To reach it (n,), kg; inf where it is out of reach.
    """

    position: Array
    p_safe: Array
    distance: Array
    propellant: Array

    def __len__(self) -> int:
        return len(self.position)

    @property
    def reachable(self) -> NDArray[np.bool_]:
        """Tell which sites can be reached (n,)."""
        return np.isfinite(self.propellant)


@dataclass(frozen=True)
class Observation:
    """What the onboard computer knows when a decision is due.

    Attributes
    ----------
    time
        s.
    estimate
        Navigation's estimate.
    hazard_map
        The map as it stands.
    candidates
        Sites to choose from.
    site
        The site flown to now, estimated ENU (3,), m.
    site_p_safe
        Probability of landing safely there; NaN while not observed.
    site_propellant
        Propellant to reach it, kg.
    time_to_go
        To the end of the approach, s.
    propellant
        Left in the tanks, kg.
    """

    time: float
    estimate: Estimate
    hazard_map: HazardMap
    candidates: Candidates
    site: Array
    site_p_safe: float
    site_propellant: float
    time_to_go: float
    propellant: float


@dataclass(frozen=True)
class Decision:
    """A policy's answer.

    Attributes
    ----------
    site
        New site, estimated ENU (3,), m; None keeps the present one.
    reason
        A few words for the record.
    details
        Figures for the record.
    """

    site: Array | None
    reason: str
    details: dict[str, float] = field(default_factory=dict)

    @classmethod
    def keep(cls, reason: str) -> Decision:
        """Stay with the present site."""
        return cls(None, reason)


class RetargetingPolicy(Protocol):
    """Anything that decides where to land."""

    @property
    def name(self) -> str:
        """Name in tables and records."""
        ...

    def decide(self, observation: Observation) -> Decision:
        """Return the decision for this observation."""
        ...
