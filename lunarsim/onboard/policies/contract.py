"""Interface of retargeting policies: observation in, decision out."""

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
from lunarsim.onboard.policies.reachability import ReachabilityMap
from lunarsim.onboard.result_checks import checked_vector, wrong_result_error

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Candidates:
    """Candidate landing sites, safest first; the present site is not included.

    All sites are eligible by the mission.

    Attributes
    ----------
    position
        Position in estimated ENU (n, 3), m; z is the terrain height.
    p_safe
        Probability of a safe landing when aiming there (n,).
    distance
        Horizontal distance from the present site (n,), m.
    propellant
        Propellant to reach it (n,), kg; inf if it is out of reach.
    value
        Value for the mission (n,), in [0, 1]; default 1.
    score
        Score of the mapper's own ranking, lower is better (n,); NaN for sites that the mapper did
        not rank, and by default.
    source
        Mapper and rule that proposed it, "MAPPER: RULE" (n,); default empty.

    Raises
    ------
    InputError
        If lengths differ, or a probability, distance, cost or value is NaN or out of range.
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
                raise InputError(
                    f"candidates.{name}", len(getattr(self, name)), f"must have {n} elements"
                )
        for name, upper in (("p_safe", 1.0), ("value", 1.0), ("distance", np.inf),
                           ("propellant", np.inf)):  # fmt: skip
            values = np.asarray(getattr(self, name), dtype=np.float64)
            is_wrong = ~((values >= 0.0) & (values <= upper))
            if is_wrong.any():
                raise InputError(
                    f"candidates.{name}",
                    float(values[is_wrong][0]),
                    f"must be between 0 and {upper:g}",
                )

    def __len__(self) -> int:
        return len(self.position)

    @property
    def reachable(self) -> NDArray[np.bool_]:
        """Whether each site can be reached (n,)."""
        return np.isfinite(self.propellant)


@dataclass(frozen=True)
class Observation:
    """Information for a policy when a decision is due.

    Attributes
    ----------
    time
        Time, s.
    estimate
        Navigation estimate.
    hazard_map
        Current hazard map.
    candidates
        Candidate sites.
    site
        Present site in estimated ENU (3,), m.
    site_p_safe
        Probability of a safe landing at the present site; NaN if it is not observed yet.
    site_propellant
        Propellant to reach the present site, kg.
    time_to_go
        Time until the planned end of the approach, s.
    propellant
        Remaining propellant, kg.
    site_eligible
        Whether the mission allows a landing at the present site.
    site_value
        Value of the present site for the mission, in [0, 1].
    scoreboard
        Sites ranked by the mapper; None if it ranks none.
    expected_miss
        Expected miss of the site relative to the map, 1 sigma per axis, m.
    reach
        Map of the cells within reach, computed on first use; None if not available.

    Raises
    ------
    InputError
        If `site_propellant` is NaN.
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
    reach: ReachabilityMap | None = None

    def __post_init__(self) -> None:
        if np.isnan(self.site_propellant):
            raise InputError(
                "observation.site_propellant",
                "NaN",
                "must be a number in kg",
                "Use inf for a site out of reach.",
            )


@dataclass(frozen=True)
class Decision:
    """Decision of a policy.

    Attributes
    ----------
    site
        New site in estimated ENU (3,), m; None keeps the present one.
    reason
        Short text for the record.
    details
        Numbers for the record.
    abort
        Whether the lander aborts the landing and climbs away.
    stretch
        Time-to-go to the site, divided by that of the minimum-propellant path from the present
        state. None: a new site gets the minimum-propellant path, a kept site keeps its arrival
        time. With 1, the path to a kept site is planned again. If the path would violate a limit of
        the approach, the minimum-propellant path is flown and "stretch-refused" is recorded. The
        same holds if the mission or a guidance law that plans its own arrival sets the time-to-go.
        A path that is replanned later, because it violates limits or navigation locks, is the
        minimum-propellant path.

    Raises
    ------
    InputError
        If an abort has a site or a stretch, or if the stretch is not finite and positive.
    """

    site: Array | None
    reason: str
    details: dict[str, float] = field(default_factory=dict)
    abort: bool = False
    stretch: float | None = None

    def __post_init__(self) -> None:
        if self.abort and self.site is not None:
            raise InputError("decision.site", self.site, "must be None for an abort")
        if self.stretch is None:
            return
        if self.abort:
            raise InputError("decision.stretch", self.stretch, "must be None for an abort")
        is_number = isinstance(self.stretch, Real) and not isinstance(self.stretch, bool)
        if not (is_number and np.isfinite(self.stretch) and self.stretch > 0.0):
            raise InputError(
                "decision.stretch", self.stretch, "must be positive and finite, or None"
            )

    @classmethod
    def keep(cls, reason: str) -> Decision:
        """Return the decision to keep the present site."""
        return cls(None, reason)

    @classmethod
    def climb_away(cls, reason: str) -> Decision:
        """Return the decision to abort the landing."""
        return cls(None, reason, abort=True)


class RetargetingPolicy(Protocol):
    """Interface of a policy that decides where to land."""

    @property
    def name(self) -> str:
        """Name in tables and records."""
        ...

    def decide(self, observation: Observation) -> Decision:
        """Return the decision for an observation."""
        ...


def checked_decision(policy: object, value: Any, time: float) -> Decision:
    """Return the decision of a policy, asked at `time` (s), after checking it.

    Raises
    ------
    InputError
        If it is not a `Decision`, or its site is not three finite numbers.
    """
    if not isinstance(value, Decision):
        raise wrong_result_error("policy", policy, "decide", value, "a Decision", time)
    if value.site is not None:
        checked_vector("policy", policy, "decide", value.site, "m as site", time)
    return value
