"""Phases of the descent and their time-to-go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum
from typing import Any

import numpy as np

from lunarsim.core.guidance import fallback_time
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.apollo import time_to_go_for_jerk
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd, PlansArrival
from lunarsim.onboard.guidance.vertical import Hovers, TerminalDescentLaw
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.site_evaluator import DescentStatus, SiteEvaluator

# Records the event with a time, s, a name and details.
RecordEvent = Callable[[float, str, dict[str, Any]], None]
# A hover ends below this horizontal and vertical speed, m/s, at most this far below its height, m.
_MAX_HOVER_END_SPEED_M_S, _MAX_HOVER_DEPTH_M = 0.4, 1.0
# Mean climb speed of a hover, m/s, and mean horizontal deceleration divided by gravity, for an
# estimate of its propellant.
_MEAN_CLIMB_SPEED_M_S, _MEAN_DECELERATION_RATIO = 2.0, 0.3


class Phase(IntEnum):
    """Phase of the descent, as recorded in the trajectory."""

    APPROACH = 0
    VERTICAL = 1
    ABORT = 2
    BRAKING = 3
    HOVER = 4


class PhaseSequence:
    """Phase of the descent and time-to-go of the current phase.

    ::

        BRAKING ----> APPROACH ----> VERTICAL     transitions: `advance`
           |           |   ^            ^  |
           |           v   |            |  |
           |           HOVER -----------+  |
           |             |                 |
           +-------------+-----------------+--> ABORT     decision: `abort`

    A flight starts with BRAKING if the scenario has a table [braking], otherwise with APPROACH.
    BRAKING ends at its final time-to-go. APPROACH ends at an altitude or at a time-to-go. If the
    vertical descent could reach the site from the planned end, but not from there, HOVER stops the
    lander and climbs above the glideslope. Then APPROACH begins again, or VERTICAL at the place
    below the lander if no path leads to the site. VERTICAL ends at touchdown. ABORT climbs until
    the end of the flight.

    The time-to-go counts down to the end of BRAKING or APPROACH. During BRAKING and with a given
    jerk, it is computed again in each cycle. Otherwise it is chosen by propellant: at the start of
    the approach, for each divert, when navigation finds its place on the map, and when commands
    exceed the limits. The mission or the guidance law can fix it.

    Parameters
    ----------
    briefing
        Data known before the flight.
    evaluator
        Evaluates the time-to-go to landing sites.
    guidance
        Guidance law of the approach.
    terminal
        Guidance law of the terminal descent.
    record
        Records an event.

    Attributes
    ----------
    phase
        Current phase.
    arrival
        Time at which the time-to-go is 0, s.
    hover_height
        Height of the centre of mass in HOVER, local frame, m; NaN before.
    """

    def __init__(
        self,
        briefing: Briefing,
        evaluator: SiteEvaluator,
        guidance: GuidanceLaw,
        terminal: TerminalDescentLaw,
        record: RecordEvent,
    ) -> None:
        software = briefing.software
        self.phase = Phase.APPROACH if software.braking is None else Phase.BRAKING
        self.arrival = briefing.time_to_go
        self._approach, self._braking, self._lander = (
            software.approach, software.braking, briefing.lander,
        )  # fmt: skip
        self.hover_height = float("nan")
        self._evaluator, self._guidance, self._record = evaluator, guidance, record
        self._terminal = terminal
        self._recorded_guidance_events = 0

    @property
    def chooses_time(self) -> bool:
        """Whether the time-to-go is chosen by propellant in the current phase."""
        return self.phase == Phase.APPROACH and self._approach.has_free_time_to_go

    def abort(self, status: DescentStatus, reason: str) -> None:
        """Set the phase to ABORT and record the event "abort".

        `reason` is the reason that the policy states, for the event.
        """
        self.phase = Phase.ABORT
        self._record(status.time, "abort", {"altitude": status.altitude, "reason": reason})

    def advance(self, status: DescentStatus) -> bool:
        """Update the time-to-go, and make the transitions that are due in this cycle.

        They are those of braking, approach and hover; vertical descent and abort do not change
        here. The result is whether the lander must land below itself, because a hover ends from
        which no path leads to its site.
        """
        if self.phase == Phase.BRAKING:
            self._advance_braking(status)
        if self.phase == Phase.APPROACH:
            self._advance_approach(status)
        return self.phase == Phase.HOVER and self._advance_hover(status)

    def _advance_braking(self, status: DescentStatus) -> None:
        """Update the time-to-go of braking; start the approach when braking ends.

        At the start of the approach, its first time-to-go is set and the event "approach" is
        recorded; if no path keeps the limits, "approach-out-of-limits" is recorded too.
        """
        end = self._braking.end(status.site)
        left = self._braking.time_left(status.estimate, end, self.arrival - status.time)
        self.arrival = status.time + left
        if left > self._braking.end_time_to_go:
            return
        self.phase = Phase.APPROACH
        details = {"altitude": status.altitude}
        self._record(status.time, "approach", details)
        end = self._approach.end(status.site, self._lander)
        optimal, _ = self._evaluator.time_to(status.site, status.estimate)
        left, within = initial_time_to_go(self._approach, status.estimate, end, optimal)
        if not within:
            self._record(status.time, "approach-out-of-limits", details)
        self.arrival = status.time + left

    def _advance_approach(self, status: DescentStatus) -> None:
        """Update the time-to-go of the approach; start the vertical descent when due.

        The time-to-go is computed only if the mission gives the jerk; otherwise it stays. The
        vertical descent starts at the final altitude or the final time-to-go of the approach.
        """
        left = self.arrival - status.time
        if self._approach.jerk is not None:
            end = self._approach.end(status.site, self._lander)
            left = time_to_go_for_jerk(status.estimate, end, self._approach.jerk, left)
            self.arrival = status.time + left
            left = self.arrival - status.time
        if not self._approach.is_finished(status.altitude, left):
            return
        touchdown = self._approach.touchdown_end(status.site, self._lander)
        is_cut_short = self._approach.is_cut_short(status.altitude, left)
        if not is_cut_short and self._has_missed(status, touchdown):
            self.begin_hover(status, touchdown)
        else:
            self._begin_vertical(status)

    def _has_missed(self, status: DescentStatus, touchdown: PhaseEnd) -> bool:
        """Return whether the approach ended too far from the site.

        This is the case if the vertical descent to its end `touchdown` could begin upright at the
        planned end of the approach, but not here. The result is False for a law that cannot hover.
        """
        if not isinstance(self._terminal, Hovers):
            return False
        end = self._approach.end(status.site, self._lander)
        planned = replace(
            status.estimate,
            position=end.position,
            velocity=end.velocity,
            attitude=np.array([0.0, 0.0, 0.0, 1.0]),
        )
        return self._terminal.can_reach(planned, touchdown) and not self._terminal.can_reach(
            status.estimate, touchdown
        )

    def _begin_vertical(self, status: DescentStatus, **details: str) -> None:
        self.phase = Phase.VERTICAL
        self._record(status.time, "vertical-descent", {"altitude": status.altitude} | details)

    def begin_hover(self, status: DescentStatus, touchdown: PhaseEnd) -> None:
        """Set the phase to HOVER; `touchdown` is the end that the descent cannot reach."""
        self.phase, self.hover_height = Phase.HOVER, float(status.estimate.position[2])
        distance = float(np.hypot(*(status.estimate.position - touchdown.position)[:2]))
        details = {"altitude": status.altitude, "distance": distance}
        self._record(status.time, "hover", details)

    def _advance_hover(self, status: DescentStatus) -> bool:
        """Begin the approach again once the lander has stopped at the height of the hover.

        Without a path to the site, the vertical descent begins, and the result is True.
        """
        velocity = status.estimate.velocity
        touchdown = self._approach.touchdown_end(status.site, self._lander).position
        distance = float(np.hypot(*(status.estimate.position - touchdown)[:2]))
        height = float(touchdown[2]) + self._approach.hover_height(distance)
        # The lander climbs higher if it drifts away from its site, unless this costs too much.
        if height > self.hover_height and self._can_approach_from(height, status):
            self.hover_height = height
        below = self.hover_height - float(status.estimate.position[2])
        speed = max(np.hypot(*velocity[:2]), abs(velocity[2]))
        if speed > _MAX_HOVER_END_SPEED_M_S or below > _MAX_HOVER_DEPTH_M:
            return False
        time_to_go, _ = self._evaluator.time_to(status.site, status.estimate)
        if not np.isfinite(time_to_go):
            self._begin_vertical(status, reason="no path to the site")
            return True
        self.phase, self.arrival = Phase.APPROACH, status.time + time_to_go
        if isinstance(self._guidance, PlansArrival):
            self._guidance.arrival = None
        self._record(status.time, "approach", {"altitude": status.altitude})
        return False

    def _can_approach_from(self, height: float, status: DescentStatus) -> bool:
        """Return whether a path leads to the site after a stop at a height (m).

        The propellant of the hover until then is estimated with mean values of climb speed and
        horizontal deceleration.
        """
        estimate, gravity = status.estimate, self._evaluator.briefing.surface_gravity
        climb = height - float(estimate.position[2])
        speed = float(np.hypot(*estimate.velocity[:2]))
        seconds = climb / _MEAN_CLIMB_SPEED_M_S + speed / (_MEAN_DECELERATION_RATIO * gravity)
        start = replace(
            estimate,
            position=np.array([*estimate.position[:2], height]),
            velocity=np.zeros(3),
            attitude=np.array([0.0, 0.0, 0.0, 1.0]),
            mass=estimate.mass * float(np.exp(-gravity * seconds / self._lander.exhaust_velocity)),
        )
        return bool(np.isfinite(self._evaluator.time_to(status.site, start)[0]))

    def allowed_time_scale(
        self, status: DescentStatus, time_scale: float | None, inhibited: bool
    ) -> tuple[float | None, str]:
        """Return the time scale that a decision may set, and why another one is refused.

        A time scale is a factor on the time-to-go. The first result is None if the decision sets
        no time scale (`time_scale` is None) or may not set one. The reason is an empty text if
        nothing is refused. `inhibited` is whether diverts are inhibited.
        """
        if time_scale is None:
            return None, ""
        why = _reason_time_is_fixed(self._approach, self._guidance)
        if inhibited:
            why = "navigation is lost"
        elif self.phase != Phase.APPROACH:
            why = "not on the approach"
        return (None, why) if why else (time_scale, "")

    def replan(self, status: DescentStatus, time_scale: float | None = None) -> str:
        """Choose a new time-to-go to the current landing site.

        It is the minimum-propellant time-to-go, multiplied by `time_scale` if this is given and
        the resulting path keeps the limits. If no path exists, or if the landing would be
        postponed too long near the terrain, the time-to-go stays. Diverts always get a new
        time-to-go; a lander that keeps its site gets one here, since otherwise diverts would appear
        to save propellant. Returns why the time scale was refused, or an empty text.
        """
        time_to_go, why = self._evaluator.time_to(status.site, status.estimate, time_scale)
        self._arrive_in(time_to_go, status)
        return why

    def _arrive_in(self, time_to_go: float, status: DescentStatus) -> bool:
        """Set a time-to-go (s), unless it postpones the landing for too long.

        The result is whether it was set; it must be finite. A refused postponement is recorded.
        """
        if not np.isfinite(time_to_go):
            return False
        later = time_to_go - (self.arrival - status.time)
        if not self._approach.allows_postponement(later, status.altitude):
            details = {"altitude": status.altitude, "seconds": later}
            self._record(status.time, "postponement-refused", details)
            return False
        self.arrival = status.time + time_to_go
        return True

    def extend(self, status: DescentStatus) -> None:
        """Extend the time-to-go to that of the minimum-propellant path, if it is longer.

        The onboard computer calls this when its commands exceed the limits. The time-to-go stays
        if no path keeps the limits, if it is already long enough, or if the mission or the
        guidance law sets it.
        """
        if _reason_time_is_fixed(self._approach, self._guidance):
            return
        time_to_go, _ = self._evaluator.time_to(status.site, status.estimate)
        left = self.arrival - status.time
        if time_to_go > left and self._arrive_in(time_to_go, status):
            self._record(status.time, "time-to-go-extended", {"seconds": time_to_go - left})

    def follow_guidance(self) -> None:
        """Adopt the arrival time planned by the guidance law, and record its new events.

        Nothing is done for a guidance law that plans no arrival time.
        """
        if not isinstance(self._guidance, PlansArrival):
            return
        if self._guidance.arrival is not None:
            self.arrival = self._guidance.arrival
        for event in self._guidance.events[self._recorded_guidance_events :]:
            self._record(*event)
        self._recorded_guidance_events = len(self._guidance.events)


def initial_time_to_go(
    approach: Approach, estimate: Estimate, end: PhaseEnd, optimal_time: float
) -> tuple[float, bool]:
    """Return the initial time-to-go of the approach, s, and whether it is admissible.

    If the settings `approach` have a jerk, the time follows from it; otherwise it is
    `approach.time_to_go`. Both count as admissible without a check of the path limits. If neither
    is set, the time is `optimal_time`, s, that of the minimum-propellant path. If this is not
    finite, no time is admissible: the results are a time from distance and speed, and False. `end`
    is the end state of the approach.
    """
    if approach.jerk is not None:
        guess = approach.time_to_go or _fallback_time(estimate, end)
        return time_to_go_for_jerk(estimate, end, approach.jerk, guess, max_change=np.inf), True
    left = approach.time_to_go or optimal_time
    return (left, True) if np.isfinite(left) else (_fallback_time(estimate, end), False)


def _reason_time_is_fixed(approach: Approach, law: GuidanceLaw) -> str:
    """Return why the onboard computer does not choose the time-to-go of the approach.

    The result is a text for messages; it is empty if the computer chooses the time-to-go.
    `approach` are the settings of the approach.
    """
    if not approach.has_free_time_to_go:
        return "the mission sets the time-to-go"
    return "the law plans its own arrival" if isinstance(law, PlansArrival) else ""


def _fallback_time(estimate: Estimate, end: PhaseEnd) -> float:
    """Estimate a time-to-go (s) from distance and speed only, without path limits."""
    distance = float(np.linalg.norm(end.position - estimate.position))
    speed = float(np.linalg.norm(estimate.velocity))
    return float(fallback_time(distance, speed))
