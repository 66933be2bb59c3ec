"""What a policy sees and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Real
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.part_results import checked_vector, wrong_result
from lunarsim.onboard.policies.reach import Reach

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Candidates:
    """Landing sites worth a look, safest first; the site flown to now is not among them.

    All are eligible by the mission.

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
    value
        How much the mission wants to land there (n,), in [0, 1]; left out: 1.
    score
        Of the mapper's own ranking, the less the better (n,); NaN for sites that others proposed,
        as when left out.
    source
        Which mapper proposed it by which rule, "MAPPER: RULE" (n,); left out: empty.

    Raises
    ------
    InputError
        If lengths differ, or a probability, distance, cost or value is NaN or impossible.
    """

    position: Array
    p_safe: Array
    distance: Array
    propellant: Array
    value: Array = field(default_factory=lambda: np.zeros(0))
    score: Array = field(default_factory=lambda: np.zeros(0))
    source: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.position)
        for name, fill in (("value", 1.0), ("score", np.nan)):
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full(n, fill))
        if not self.source:
            object.__setattr__(self, "source", ("",) * n)
        for name in ("p_safe", "distance", "propellant", "value", "score", "source"):
            if len(getattr(self, name)) != n:
                raise InputError(f"candidates.{name}", len(getattr(self, name)), f"{n} of them")
        for name, most in (("p_safe", 1.0), ("value", 1.0), ("distance", np.inf),
                           ("propellant", np.inf)):  # fmt: skip
            given = np.asarray(getattr(self, name), dtype=np.float64)
            wrong = ~((given >= 0.0) & (given <= most))
            if wrong.any():
                raise InputError(
                    f"candidates.{name}", float(given[wrong][0]), f"numbers from 0 to {most:g}"
                )

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
    site_eligible, site_value
        Whether the mission lets the lander land at the site, and how much it wants to, in [0, 1].
    scoreboard
        Sites that the mapper has ranked itself; None if it ranks none.
    expected_miss
        Of the site on the map, 1 sigma an axis, m.
    reach
        Where on the map it can still land; surveyed when a policy first looks. None if nobody told.

    Raises
    ------
    InputError
        If the cost of the site is NaN.
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
    site_eligible: bool = True
    site_value: float = 1.0
    scoreboard: Scoreboard | None = None
    expected_miss: float = 0.0
    reach: Reach | None = None

    def __post_init__(self) -> None:
        if np.isnan(self.site_propellant):
            raise InputError("observation.site_propellant", "NaN", "kg, inf where out of reach")


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
    abort
        Whether the lander is to give up the landing and climb away.
    stretch
        Time-to-go to the site over that of the cheapest admissible path there, from where the
        lander is: which of the paths of its law is flown. None: a new site gets the cheapest, a
        kept one keeps its arrival. A stretch of 1 plans a kept one afresh. What would break a limit
        of the approach gives way to the cheapest, "stretch-refused" in the record. So it is where
        somebody else sets the time-to-go: the mission, which fixes it, or a law that plans its own
        arrival. A path that is planned afresh later, as it asked for too much or as navigation
        locks, is the cheapest.

    Raises
    ------
    InputError
        If an abort names a site or a stretch, or a stretch is not finite and positive.
    """

    site: Array | None
    reason: str
    details: dict[str, float] = field(default_factory=dict)
    abort: bool = False
    stretch: float | None = None

    def __post_init__(self) -> None:
        if self.abort and self.site is not None:
            raise InputError("decision.site", self.site, "None for an abort")
        if self.stretch is None:
            return
        if self.abort:
            raise InputError("decision.stretch", self.stretch, "None for an abort")
        number = isinstance(self.stretch, Real) and not isinstance(self.stretch, bool)
        if not (number and np.isfinite(self.stretch) and self.stretch > 0.0):
            raise InputError("decision.stretch", self.stretch, "a positive finite number, or None")

    @classmethod
    def keep(cls, reason: str) -> Decision:
        """Stay with the present site."""
        return cls(None, reason)

    @classmethod
    def climb_away(cls, reason: str) -> Decision:
        """Give up the landing."""
        return cls(None, reason, abort=True)


class RetargetingPolicy(Protocol):
    """Anything that decides where to land."""

    @property
    def name(self) -> str:
        """Name in tables and records."""
        ...

    def decide(self, observation: Observation) -> Decision:
        """Return the decision for this observation."""
        ...


def checked_decision(policy: object, value: Any, time: float) -> Decision:
    """Return the decision of a policy, which was asked at a time (s).

    Raises
    ------
    InputError
        If it is not a `Decision`, or its site is not three finite numbers.
    """
    if not isinstance(value, Decision):
        raise wrong_result("policy", policy, "decide", value, "a Decision", time)
    if value.site is not None:
        checked_vector("policy", policy, "decide", value.site, "m as the site", time)
    return value
