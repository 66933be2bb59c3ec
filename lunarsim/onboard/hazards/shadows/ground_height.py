"""How well the height of the ground is known between the rocks that are tracked.

Rocks hold the map to the ground: their own places are known. Ground between them is as high as they
tell, and by how much it may be higher or lower grows with the way to them and with how far the
heights of neighbours differ. Seen from the side, a place whose height is off by a metre shows a
metre and more beside itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.wandering_ground import NEIGHBOURS

Array = NDArray[np.float64]

# Each rock is compared with so many others near by.
_NEIGHBOUR_PAIRS = 3
# What is known of relief beforehand counts as much as ways between rocks of so many metres.
_PRIOR_WEIGHT_M = 10.0


def height_variance_growth(rocks: RockFilter) -> float:
    """Return by how much the variance of heights grows with a metre between them, m^2/m.

    The mean over neighbours of the squared difference of their heights, each taken with what it
    errs by: rocks of which no picture has told the height yet say what was known before. Of no more
    than one rock that is all.
    """
    prior = rocks.expected_growth
    if rocks.count < 2:
        return prior
    others = np.arange(2, min(_NEIGHBOUR_PAIRS, rocks.count - 1) + 2)
    distance, near = cKDTree(rocks.xy).query(rocks.xy, k=others)
    height = rocks.xyz[:, 2]
    rise = np.square(height[:, None] - height[near]) + rocks.rise_variance(near)
    return float((prior * _PRIOR_WEIGHT_M + rise.sum()) / (_PRIOR_WEIGHT_M + distance.sum()))


def height_sigma(rocks: RockFilter, xy: Array) -> Array:
    """Return how well the ground's height below the lander is known at points (n, 2).

    As the best of the nearest rocks tells: by what its own height errs and what the ground may rise
    on the way from it.

    Returns
    -------
    sigma
        1 sigma (n,), m; infinite if no rock is tracked.
    """
    if rocks.count == 0:
        return np.full(len(xy), np.inf)
    nearest = np.arange(1, min(NEIGHBOURS, rocks.count) + 1)
    distance, near = cKDTree(rocks.xy).query(xy, k=nearest)
    own = rocks.relative_covariance()[:, 2, 2]
    return np.asarray(np.sqrt((own[near] + height_variance_growth(rocks) * distance).min(axis=1)))
