"""Interface of retargeting policies: observation in, decision out."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Real
from typing import Any, Protocol, runtime_checkable

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.component_errors import checked_vector, wrong_result_error
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.reachability import ReachabilityMap
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import check_elements


@dataclass(frozen=True)
class Candidates:
    """Candidate landing sites, safest first.

    The mission allows a landing at each of them. The cell of the current site can be among them.

    Attributes
    ----------
    position
        Position in estimated ENU (n, 3), m; z is the terrain height.
    p_safe
        Probability of a safe landing when aiming at the site (n,).
    distance
        Horizontal distance from the current site (n,), m.
    propellant
        Propellant to reach the site (n,), kg; inf if the site is out of reach.
    value
        Value for the mission (n,), in [0, 1]; default 1.
    score
        Score in the mapper's own ranking (n,), lower is better; NaN (default) for sites that the
        mapper did not rank.
    source
        Mapper and rule that proposed the site, "MAPPER: RULE" (n,); default empty.

    Raises
    ------
    InputError
        If lengths differ, or a probability, distance, propellant or value is NaN or out of range.
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
                    f"candidates.{name}",
                    len(getattr(self, name)),
                    f"must have as many elements as position, which has {n}",
                )
        for name, upper in (("p_safe", 1.0), ("value", 1.0), ("distance", np.inf),
                           ("propellant", np.inf)):  # fmt: skip
            values = np.asarray(getattr(self, name), dtype=np.float64)
            is_valid = (values >= 0.0) & (values <= upper)
            problem = "must be 0 or more" if upper == np.inf else f"must be between 0 and {upper:g}"
            check_elements(f"candidates.{name}", values, is_valid, problem)

    def __len__(self) -> int:
        return len(self.position)

    @property
    def reachable(self) -> BoolArray:
        """Whether the lander can fly to each site within its limits (n,)."""
        return np.isfinite(self.propellant)


@dataclass(frozen=True)
class Observation:
    """Information that a retargeting policy gets when a decision is due.

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
        Current landing site in estimated ENU (3,), m.
    site_p_safe
        Probability of a safe landing at the current site; NaN if the site is not observed yet.
    site_propellant
        Propellant to reach the current site, kg.
    time_to_go
        Time until the planned end of the approach, s.
    propellant
        Remaining propellant, kg.
    site_eligible
        Whether the mission allows a landing at the current site.
    site_value
        Value of the current site for the mission, in [0, 1].
    scoreboard
        Sites ranked by the mapper; None if the mapper ranks none.
    expected_miss
        Expected touchdown error relative to the map at the current site, 1 sigma per axis, m.
    reachability
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
    reachability: ReachabilityMap | None = None

    def __post_init__(self) -> None:
        if np.isnan(self.site_propellant):
            raise InputError(
                "observation.site_propellant",
                self.site_propellant,
                "must not be NaN",
                "Use inf for a site out of reach.",
            )


@dataclass(frozen=True)
class Decision:
    """Decision of a policy: keep the landing site, divert to another one, or abort.

    Attributes
    ----------
    site
        New site in estimated ENU (3,), m; None keeps the current one.
    reason
        Short text for the record.
    details
        Numbers for the record.
    abort
        Whether the lander aborts the landing and climbs away.
    time_scale
        Time-to-go to the site, divided by that of the minimum-propellant path from the current
        state. None: a new site gets the minimum-propellant path. A kept site keeps its arrival
        time, except at the first decision, when its path is planned again if the time-to-go is
        free. With 1, the path to a kept site is planned again. If the path would violate a limit of
        the approach, the minimum-propellant path is flown and "time-scale-refused" is recorded. A
        time scale is also refused if navigation is lost, before or after the approach, or if the
        mission or the guidance law sets the time-to-go; it then counts as None. A path that is
        replanned later, because it violates limits or navigation locks, is the minimum-propellant
        path.

    Raises
    ------
    InputError
        If an abort has a site or a time scale, or if the time scale is not finite and positive.

    Examples
    --------
    >>> Decision.keep("no better site").site is None
    True
    >>> Decision(np.array([3.0, 4.0, 0.0]), "safest site", {"p_safe": 0.97}).details
    {'p_safe': 0.97}
    """

    site: Array | None
    reason: str
    details: dict[str, float] = field(default_factory=dict)
    abort: bool = False
    time_scale: float | None = None

    def __post_init__(self) -> None:
        if self.abort and self.site is not None:
            raise InputError("decision.site", self.site, "must be None if abort is True")
        if self.time_scale is None:
            return
        if self.abort:
            raise InputError(
                "decision.time_scale", self.time_scale, "must be None if abort is True"
            )
        is_number = isinstance(self.time_scale, Real) and not isinstance(self.time_scale, bool)
        if not (is_number and np.isfinite(self.time_scale) and self.time_scale > 0.0):
            raise InputError(
                "decision.time_scale", self.time_scale, "must be None, or positive and finite"
            )

    @classmethod
    def keep(cls, reason: str) -> Decision:
        """Return the decision to keep the current site, for a given reason."""
        return cls(None, reason)

    @classmethod
    def climb_away(cls, reason: str) -> Decision:
        """Return the decision to abort the landing, for a given reason."""
        return cls(None, reason, abort=True)


class RetargetingPolicy(Protocol):
    """Interface of a policy that decides during the descent where to land."""

    @property
    def name(self) -> str:
        """Name of the policy in tables and records."""
        ...

    def decide(self, observation: Observation) -> Decision:
        """Return the decision (keep, divert or abort) for an observation."""
        ...


@runtime_checkable
class BuiltPerFlight(Protocol):
    """Settings of a policy that is built for each flight."""

    def build(self, briefing: Briefing) -> RetargetingPolicy:
        """Return the policy of one flight, built from its briefing."""
        ...


def checked_decision(policy: object, value: Any, time: float) -> Decision:
    """Return a policy's return value (`value`) after checking that it is a `Decision`.

    `time` (s) is the time of the decision, for the error message.

    Raises
    ------
    InputError
        If the value is not a `Decision`, or its site is not three finite numbers.
    """
    if not isinstance(value, Decision):
        raise wrong_result_error("policy", policy, "decide", value, "a Decision", time)
    if value.site is not None:
        checked_vector("policy", policy, "decide", value.site, "m as site", time)
    return value
