"""By how much a lander will miss the site that it aims at, on its own map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
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


class Aim:
    """The map that decides, spread by the miss that is expected.

    Parameters
    ----------
    stated
        What guidance and map miss by without any drift, an axis, m.
    descent
        From the end of an approach to the ground, s.

    Attributes
    ----------
    mapped_at
        When something was mapped last, s.
    """

    def __init__(self, stated: float, descent: float) -> None:
        self.mapped_at = 0.0
        self._stated, self._descent = stated, descent
        self._spread: tuple[FloatMap, float, FloatMap] | None = None

    def misses(self, estimate: Estimate, adrift: bool, time_to_go: Array) -> Array:
        """Return `expected_miss` of sites whose approach takes so long from now on (n,), s."""
        since = estimate.time - self.mapped_at
        return expected_miss(self._stated, estimate, adrift, since + time_to_go + self._descent)

    def spread(self, hazard_map: HazardMap, miss: float) -> FloatMap:
        """Return `HazardMap.dispersed`, once for a map and a miss."""
        # A map may come again with its ground moved alone.
        kept = self._spread
        if kept is None or kept[0] is not hazard_map.p_safe or kept[1] != miss:
            kept = self._spread = (hazard_map.p_safe, miss, hazard_map.dispersed(miss))
        return kept[2]
