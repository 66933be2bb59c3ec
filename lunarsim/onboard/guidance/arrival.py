"""How long the approach is to take when it begins, and who decides on that."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.guidance.apollo import followed_time
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd, PlansArrival
from lunarsim.onboard.navigation.estimate import Estimate

# A lander for which nothing is admissible takes so many times its way over its speed, at least so
# long, s, and is taken to be no slower than this, m/s.
_TIMES, _LEAST, _SLOWEST = 2.0, 5.0, 1.0


def time_at_gate(
    approach: Approach, estimate: Estimate, end: PhaseEnd, admissible: float
) -> tuple[float, bool]:
    """Return the time-to-go with which the approach begins, s, and whether it is within limits.

    By the jerk that the mission wants, the time that it fixes, or else that which is admissible,
    s: not finite where none is. Then the lander flies there all the same, as long as way and speed
    want.
    """
    if approach.jerk is not None:
        guess = approach.time_to_go or plain_time(estimate, end)
        return followed_time(estimate, end, approach.jerk, guess, share=np.inf), True
    left = approach.time_to_go or admissible
    return (left, True) if np.isfinite(left) else (plain_time(estimate, end), False)


def set_by_others(approach: Approach, law: GuidanceLaw) -> str:
    """Return why the computer does not choose the time-to-go; empty where it does."""
    if not approach.free:
        return "the mission sets the time-to-go"
    return "the law plans its own arrival" if isinstance(law, PlansArrival) else ""


def plain_time(estimate: Estimate, end: PhaseEnd) -> float:
    """Return a time-to-go by way and speed alone, s."""
    way = float(np.linalg.norm(end.position - estimate.position))
    speed = float(np.linalg.norm(estimate.velocity))
    return max(_TIMES * way / max(speed, _SLOWEST), _LEAST)
