"""Accuracy of navigation that a landing needs."""

from __future__ import annotations

import math

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.onboard.navigation.estimate import Estimate

# Standard deviations of the velocity that must be within the limits at touchdown.
_SIGMAS = 3.0


def allows_landing(estimate: Estimate, lander: Lander) -> bool:
    """Return whether the velocity is known well enough to land.

    Three standard deviations of the vertical velocity, and of the horizontal velocity in its worst
    direction, must be within the limits of `lander` at touchdown. The position is not tested: an
    error that lander and map share is harmless, and `LandingDispersion` includes the rest.
    """
    (east, north, up), mixed = np.diag(estimate.covariance)[3:6].tolist(), estimate.covariance[3, 4]
    # Larger eigenvalue; infinite variances give NaN, which is within no limit.
    horizontal = 0.5 * (east + north) + math.hypot(0.5 * (east - north), float(mixed))
    return bool(
        _SIGMAS**2 * horizontal <= lander.horizontal_speed_limit**2
        and _SIGMAS**2 * up <= lander.vertical_speed_limit**2
    )
