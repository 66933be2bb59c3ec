"""By how much a lander will miss the site that it aims at, on its own map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]

# Whatever misses by more has no site to choose, m.
MOST = 30.0


def expected_miss(stated: float, estimate: Estimate, adrift: bool, seconds: ArrayLike) -> Array:
    """Return the standard deviation of the miss over the ground, an axis (n,), m: 30 m at most.

    Where map and lander share an error it does no harm. What does is by how much the lander drifts
    over its map: where nothing holds it there, by what its velocity errs by, all the time from what
    was mapped last until touchdown. That error changes little in tens of seconds, since it is
    mostly what the beams of a velocimeter err by. Scans that were laid beside each other by a tilt
    that is not known do not count.

    Parameters
    ----------
    stated
        What guidance and map miss by without any drift, an axis, m.
    estimate
        Of now, with the covariance of the velocity.
    adrift
        Whether nothing holds the lander to what it has mapped, see `Navigation.adrift`.
    seconds
        From what was mapped last until touchdown (n,), s.
    """
    time = np.atleast_1d(np.asarray(seconds, np.float64))
    if not adrift:
        return np.full(len(time), stated)
    level = estimate.covariance[3:5, 3:5]
    speed = float(np.sqrt(max(0.5 * np.trace(level), 0.0)))
    miss = np.hypot(stated, speed * np.maximum(time, 0.0))
    return np.minimum(np.where(np.isfinite(miss), miss, MOST), max(MOST, stated))
