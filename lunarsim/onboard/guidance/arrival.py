"""Choice of the time-to-go at the start of the approach."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.guidance.apollo import followed_time
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd, PlansArrival
from lunarsim.onboard.navigation.estimate import Estimate

# Fallback time-to-go if none is admissible: this multiple of distance over speed, at least this
# time (s); the speed is taken as at least the last value (m/s).
_TIMES, _LEAST, _SLOWEST = 2.0, 5.0, 1.0


def time_at_gate(
    approach: Approach, estimate: Estimate, end: PhaseEnd, admissible: float
) -> tuple[float, bool]:
    """Return the initial time-to-go of the approach, s, and whether it is admissible.

    It follows from the jerk or the time that the mission sets, else it is `admissible`, s. If that
    is not finite, no time is admissible, and a fallback from distance and speed is returned.
    """
    if approach.jerk is not None:
        guess = approach.time_to_go or plain_time(estimate, end)
        return followed_time(estimate, end, approach.jerk, guess, share=np.inf), True
    left = approach.time_to_go or admissible
    return (left, True) if np.isfinite(left) else (plain_time(estimate, end), False)


def set_by_others(approach: Approach, law: GuidanceLaw) -> str:
    """Return why the computer does not choose the time-to-go; empty if it does."""
    if not approach.free:
        return "the mission sets the time-to-go"
    return "the law plans its own arrival" if isinstance(law, PlansArrival) else ""


def plain_time(estimate: Estimate, end: PhaseEnd) -> float:
    """Return a time-to-go from distance and speed only, s."""
    way = float(np.linalg.norm(end.position - estimate.position))
    speed = float(np.linalg.norm(estimate.velocity))
    return max(_TIMES * way / max(speed, _SLOWEST), _LEAST)
