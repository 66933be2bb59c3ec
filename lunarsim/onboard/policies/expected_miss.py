"""Estimate the landing error of the lander relative to its own map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array

# Upper limit of the expected landing error, m. With larger errors no site can be selected anyway.
MAX_EXPECTED_MISS_M = 30.0


def expected_miss(
    base_sigma: float, estimate: Estimate, is_drifting: bool, seconds: ArrayLike
) -> Array:
    """Return the expected horizontal landing error relative to the map.

    The result (n,) is 1 sigma per axis, m, and at most 30 m unless `base_sigma` is larger. An error
    common to map and lander is harmless. What matters is the drift of the lander relative to its
    map between the last mapped scan and touchdown. Without a sensor that measures the position on
    the map, this drift is the velocity error times the elapsed time. The velocity error is mostly
    the bias of the velocimeter beams, which changes little within tens of seconds. Misalignment
    between scans that results from an unknown map tilt is not included.

    Parameters
    ----------
    base_sigma
        Landing error of guidance and map without drift, 1 sigma per axis, m.
    estimate
        Current estimate with the covariance of the velocity.
    is_drifting
        Whether no measurement bounds the lander's position error relative to its map
        (`Navigation.is_drifting`).
    seconds
        Time from the last mapped scan to touchdown (n,), s.
    """
    time = np.atleast_1d(np.asarray(seconds, np.float64))
    if not is_drifting:
        return np.full(len(time), base_sigma)
    horizontal = estimate.covariance[3:5, 3:5]
    speed = float(np.sqrt(max(0.5 * np.trace(horizontal), 0.0)))
    miss = np.hypot(base_sigma, speed * np.maximum(time, 0.0))
    return np.minimum(
        np.where(np.isfinite(miss), miss, MAX_EXPECTED_MISS_M), max(MAX_EXPECTED_MISS_M, base_sigma)
    )


class LandingDispersion:
    """Averages the map of p_safe over the expected landing error.

    Parameters
    ----------
    base_sigma
        Landing error of guidance and map without drift, 1 sigma per axis, m.
    descent_time
        Time from the end of the approach to touchdown, s.

    Attributes
    ----------
    last_scan_time
        Time of the last mapped scan, s.
    """

    def __init__(self, base_sigma: float, descent_time: float) -> None:
        self.last_scan_time = 0.0
        self._base_sigma, self._descent_time = base_sigma, descent_time
        self._cached: tuple[FloatMap, float, FloatMap] | None = None

    def expected_misses(self, estimate: Estimate, is_drifting: bool, time_to_go: Array) -> Array:
        """Return the expected landing errors for times-to-go (n,), s: 1 sigma per axis, m.

        `is_drifting` states whether no measurement bounds the lander's position error relative to
        its map.
        """
        elapsed = estimate.time - self.last_scan_time
        return expected_miss(
            self._base_sigma, estimate, is_drifting, elapsed + time_to_go + self._descent_time
        )

    def averaged_p_safe(self, hazard_map: HazardMap, miss: float) -> FloatMap:
        """Return the p_safe of each cell averaged over a landing error (rows, cols).

        `miss` is the landing error, 1 sigma per axis, m. The result is cached for the last map and
        error.
        """
        # A new map object can share its p_safe layer with the last one; only that layer matters
        # here.
        cached = self._cached
        if cached is None or cached[0] is not hazard_map.p_safe or cached[1] != miss:
            cached = self._cached = (hazard_map.p_safe, miss, hazard_map.dispersed_p_safe(miss))
        return cached[2]
