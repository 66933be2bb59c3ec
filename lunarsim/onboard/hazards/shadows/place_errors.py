"""How well places between tracked rocks are known from the lander.

What a picture shows of the ground is noted of places that move as the rocks do, by what these move
in the mean (`lunarsim.onboard.hazards.shadows.sliding`). So a place errs from the lander as the
mean of the rocks about does: by what they share with each other but not with the lander, and by a
share of what each of them errs by itself. Where one of them is known badly the mean is; the median
of what they err by, each by itself, bounds the error too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lunarsim.onboard.navigation.rock_filter import RockFilter

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# How many rocks about a place tell how well it is known.
_NEIGHBOUR_COUNT = 8


def position_sigma(rocks: RockFilter, xy: Array, enough: float = 0.0) -> Array:
    """Return how well places (n, 2) are known from the lander, 1 sigma an axis (n,), m.

    Infinite if no rock is tracked: from picture to picture the lander's own place and attitude then
    err by more than a rock.

    Parameters
    ----------
    rocks
        The filter that tracks them.
    xy
        East and north of the places, m.
    enough
        Where the median is no more than this, m, that is given without asking for the mean.
    """
    if rocks.count == 0:
        return np.full(len(xy), np.inf)
    rock_sigma = np.sqrt(0.5 * np.trace(rocks.relative_covariance()[:, :2, :2], axis1=1, axis2=2))
    near = cKDTree(rocks.xy).query(xy, k=np.arange(1, min(_NEIGHBOUR_COUNT, rocks.count) + 1))[1]
    sigma = np.asarray(np.median(rock_sigma[near], axis=1))
    is_uncertain = sigma > enough
    sigma[is_uncertain] = np.minimum(sigma[is_uncertain], _mean_sigma(rocks, near[is_uncertain]))
    return sigma


def _mean_sigma(rocks: RockFilter, near: Index) -> Array:
    """Return how well the mean place of rocks (n, k) is known from the lander, 1 sigma (n,), m."""
    p, places = rocks.state.for_rows(), rocks.places()
    variance = np.zeros(len(near))
    for axis in range(2):
        at = places[near, axis]
        between = rocks.state.between(at[:, :, None], at[:, None, :]).mean((1, 2))
        variance += 0.5 * (between - 2.0 * p[axis, at].mean(1) + p[axis, axis])
    return np.sqrt(np.maximum(variance, 0.0))
