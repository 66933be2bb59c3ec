"""Error of positions between tracked rocks, relative to the lander.

Evidence from images is stored at positions that follow the mean motion of the rocks
(`lunarsim.onboard.hazards.shadows.map_motion`). The error of a position is thus that of the mean of
the nearby rocks: the error that they share with each other but not with the lander, plus a
fraction of their individual errors. A single inaccurate rock increases it. The median of the
individual errors is another upper bound.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.typing import Array, IntArray

# Number of nearby rocks that determine the error.
_NEIGHBOUR_COUNT = 8


def position_sigma(rocks: RockFilter, xy: Array, sufficient_sigma: float = 0.0) -> Array:
    """Return the error of terrain positions relative to the lander, 1 sigma per axis.

    The error (n,), m, is that of the tracked rocks near each position. It is infinite without
    tracked rocks, because the navigation error between images then exceeds the size of a rock.

    Parameters
    ----------
    rocks
        Filter of the tracked rocks.
    xy
        Positions (n, 2), east and north, m.
    sufficient_sigma
        If the median error of the nearby rocks is at most this value, m, it is returned without
        computing the smaller error of their mean.
    """
    if rocks.count == 0:
        return np.full(len(xy), np.inf)
    rock_sigma = np.sqrt(0.5 * np.trace(rocks.relative_covariance()[:, :2, :2], axis1=1, axis2=2))
    near = cKDTree(rocks.xy).query(xy, k=np.arange(1, min(_NEIGHBOUR_COUNT, rocks.count) + 1))[1]
    sigma = np.asarray(np.median(rock_sigma[near], axis=1))
    is_uncertain = sigma > sufficient_sigma
    sigma[is_uncertain] = np.minimum(sigma[is_uncertain], _mean_sigma(rocks, near[is_uncertain]))
    return sigma


def _mean_sigma(rocks: RockFilter, groups: IntArray) -> Array:
    """Return the error of the mean position of groups of rocks (n,), 1 sigma, m.

    `groups` (n, k) are the indices of the rocks in each group.
    """
    p, places = rocks.state.covariance_for_rows(), rocks.state_indices()
    variance = np.zeros(len(groups))
    for axis in range(2):
        at = places[groups, axis]
        between = rocks.state.pair_covariances(at[:, :, None], at[:, None, :]).mean((1, 2))
        variance += 0.5 * (between - 2.0 * p[axis, at].mean(1) + p[axis, axis])
    return np.sqrt(np.maximum(variance, 0.0))
