"""Climbing away from a landing that is given up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.guidance.contract import refuse_unknown
from lunarsim.onboard.navigation.estimate import Estimate

# Share of the sideways speed that is taken out in a second.
_DAMPING = 0.2


def climb(estimate: Estimate, most: float) -> NDArray[np.float64]:
    """Return the thrust acceleration (3,), ENU, m/s^2, of a climb: full thrust, sideways speed out.

    Parameters
    ----------
    estimate
        Where the lander is.
    most
        Thrust over mass at full throttle, m/s^2.
    """
    refuse_unknown(estimate)
    sideways = -_DAMPING * estimate.velocity[:2]
    size = float(np.hypot(*sideways))
    if size > 0.5 * most:
        sideways = sideways * (0.5 * most / size)
    up = np.sqrt(most**2 - float(sideways @ sideways))
    return np.array([sideways[0], sideways[1], up])
