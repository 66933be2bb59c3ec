"""Choice of the time-to-go at the start of the approach."""

from __future__ import annotations

import numpy as np

from lunarsim.core import guidance as core
from lunarsim.onboard.guidance.apollo import time_to_go_for_jerk
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd, PlansArrival
from lunarsim.onboard.navigation.estimate import Estimate


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
        guess = approach.time_to_go or fallback_time(estimate, end)
        return time_to_go_for_jerk(estimate, end, approach.jerk, guess, max_change=np.inf), True
    left = approach.time_to_go or optimal_time
    return (left, True) if np.isfinite(left) else (fallback_time(estimate, end), False)


def reason_time_is_fixed(approach: Approach, law: GuidanceLaw) -> str:
    """Return why the onboard computer does not choose the time-to-go of the approach.

    The result is a text for messages; it is empty if the computer chooses the time-to-go.
    `approach` are the settings of the approach.
    """
    if not approach.has_free_time_to_go:
        return "the mission sets the time-to-go"
    return "the law plans its own arrival" if isinstance(law, PlansArrival) else ""


def fallback_time(estimate: Estimate, end: PhaseEnd) -> float:
    """Estimate a time-to-go (s) from distance and speed only, without path limits."""
    distance = float(np.linalg.norm(end.position - estimate.position))
    speed = float(np.linalg.norm(estimate.velocity))
    return float(core.fallback_time(distance, speed))
