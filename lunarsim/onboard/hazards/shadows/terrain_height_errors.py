"""Error of the terrain height between tracked rocks.

The map is tied to the terrain by the rocks, whose positions are known. Terrain heights between them
are interpolated. The error grows with the distance to the rocks and with the height differences of
neighbours. Seen from the side, a height error of 1 m displaces a point by 1 m or more.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.terrain_heights import NEIGHBOUR_COUNT
from lunarsim.typing import Array

# Number of neighbours with which each rock is compared.
_NEIGHBOUR_PAIRS = 3
# Weight of the prior, as a total distance between rocks, m.
_PRIOR_WEIGHT_M = 10.0


def height_variance_growth(rocks: RockFilter) -> float:
    """Estimate the growth of the terrain height variance per metre of distance, m^2/m.

    The estimate is the mean squared height difference of neighbouring rocks, plus the variance of
    its error, per distance. It is averaged with the prior, which is returned for fewer than two
    rocks.
    """
    prior = rocks.prior_variance_growth
    if rocks.count < 2:
        return prior
    others = np.arange(2, min(_NEIGHBOUR_PAIRS, rocks.count - 1) + 2)
    distance, near = cKDTree(rocks.xy).query(rocks.xy, k=others)
    height = rocks.xyz[:, 2]
    rise = np.square(height[:, None] - height[near]) + rocks.height_difference_variance(near)
    return float((prior * _PRIOR_WEIGHT_M + rise.sum()) / (_PRIOR_WEIGHT_M + distance.sum()))


def height_sigma(rocks: RockFilter, xy: Array) -> Array:
    """Return the error of the terrain height between tracked rocks at points (n, 2).

    The error (n,), m, 1 sigma, is relative to the lander; it is infinite without tracked rocks. The
    variance is the minimum over the nearest rocks of the height variance of the rock plus its
    growth with distance.
    """
    if rocks.count == 0:
        return np.full(len(xy), np.inf)
    nearest = np.arange(1, min(NEIGHBOUR_COUNT, rocks.count) + 1)
    distance, near = cKDTree(rocks.xy).query(xy, k=nearest)
    own = rocks.relative_covariance()[:, 2, 2]
    return np.asarray(np.sqrt((own[near] + height_variance_growth(rocks) * distance).min(axis=1)))
