"""Climb after an abort of the landing."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.guidance.contract import require_finite_state
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array

# Fraction of the horizontal velocity removed per second.
_DAMPING_PER_S = 0.2


def climb(estimate: Estimate, max_acceleration: float) -> Array:
    """Return the thrust acceleration (3,), ENU, m/s^2, of a full-thrust climb.

    A part of the thrust removes the horizontal velocity.

    Parameters
    ----------
    estimate
        Estimated state.
    max_acceleration
        Maximum thrust divided by mass, m/s^2.
    """
    require_finite_state(estimate)
    horizontal = -_DAMPING_PER_S * estimate.velocity[:2]
    size = float(np.hypot(*horizontal))
    if size > 0.5 * max_acceleration:
        horizontal = horizontal * (0.5 * max_acceleration / size)
    up = np.sqrt(max_acceleration**2 - float(horizontal @ horizontal))
    return np.array([horizontal[0], horizontal[1], up])
