"""Which detection belongs to which tracked rock."""

from __future__ import annotations

from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import cKDTree

from lunarsim.onboard.navigation.planar import largest_eigenvalue, squared_distance

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Chi-squared of pixel and radius, 3 degrees of freedom, at 99.9 %.
GATE = 16.27
# By as much must a rival's squared distance be greater for a pair to be sure.
_MIN_RIVAL_MARGIN = 6.0


def associate(
    pixel: Array,
    pixel_covariance: Array,
    radius: Array,
    radius_variance: Array,
    predicted: Array,
    predicted_covariance: Array,
    tracked_radius: Array,
    tracked_variance: Array,
    gate: float = GATE,
) -> tuple[Index, Index, NDArray[np.bool_], NDArray[np.bool_]]:
    """Pair detections with rocks so that the sum of squared Mahalanobis distances is least.

    A detection that is left alone costs `gate`, so no pair lies farther apart than that.

    Parameters
    ----------
    pixel, pixel_covariance, radius, radius_variance
        Detections (d, 2), (d, 2, 2), (d,), (d,).
    predicted, predicted_covariance, tracked_radius, tracked_variance
        Rocks (t, 2), (t, 2, 2), (t,), (t,).

    Returns
    -------
    detection, rock
        The pairs (p,), by rising detection.
    sure
        Whether each pair has no rival (p,): no other detection in the rock's gate that is nearly
        as near, nor another rock in the detection's.
    close
        Whether a detection lies in the gate of some rock (d,), its own or another's.
    """
    none = np.empty(0, np.int64)
    d, t = len(pixel), len(predicted)
    if d == 0 or t == 0:
        return none, none, np.zeros(0, bool), np.zeros(d, bool)
    spread = np.sqrt(
        largest_eigenvalue(predicted_covariance).max() + largest_eigenvalue(pixel_covariance)
    )
    i, j = _neighbours(pixel, predicted, np.sqrt(gate) * spread)
    offset = pixel[i] - predicted[j]
    s = pixel_covariance[i] + predicted_covariance[j]
    distance = squared_distance(offset, s)
    distance += (radius[i] - tracked_radius[j]) ** 2 / (radius_variance[i] + tracked_variance[j])
    inside = distance < gate
    i, j, distance = i[inside], j[inside], distance[inside]
    is_gated = np.zeros(d, bool)
    is_gated[i] = True
    detection, rock = _optimal_pairs(i, j, distance, d, t, gate)
    own = np.full(d, -1)
    own[detection] = rock
    mate = np.full(t, -1)
    mate[rock] = detection
    is_unambiguous = _is_unambiguous(i, j, distance, own, mate)
    return detection, rock, is_unambiguous[detection], is_gated


def _neighbours(points: Array, others: Array, reach: Array) -> tuple[Index, Index]:
    """Return all pairs of a point (d, 2) and another (t, 2) within its reach (d,)."""
    near = cKDTree(others).query_ball_point(points, reach)
    i = np.repeat(np.arange(len(points)), [len(n) for n in near])
    return i, np.fromiter(chain.from_iterable(near), np.int64, i.size)


def _optimal_pairs(
    i: Index, j: Index, distance: Array, d: int, t: int, unpaired_cost: float
) -> tuple[Index, Index]:
    """Return which of the pairs (i, j) of d and t make the least sum; one alone costs `alone`."""
    # One column a detection for "none of the rocks"; weights must not be 0, an absent entry.
    each = np.arange(d)
    cost = csr_array(
        (
            np.concatenate((distance, np.full(d, unpaired_cost))) + 1.0,
            (np.concatenate((i, each)), np.concatenate((j, t + each))),
        ),
        shape=(d, t + d),
    )
    rows, column = min_weight_full_bipartite_matching(cost)
    paired = column < t
    return np.asarray(rows[paired], np.int64), np.asarray(column[paired], np.int64)


def _is_unambiguous(
    i: Index, j: Index, distance: Array, own: Index, mate: Index
) -> NDArray[np.bool_]:
    """Tell which detections (d,) are by far nearer to their rock than any rival of the pair.

    `own` is the rock of each detection (d,) and `mate` the detection of each rock (t,), -1 for
    none.
    """
    cost = np.full(len(own), np.inf)
    is_pair = own[i] == j
    cost[i[is_pair]] = distance[is_pair]
    # A rival: the same detection with another rock, or the same rock with another detection.
    rival = np.full(len(own), np.inf)
    np.minimum.at(rival, i[~is_pair], distance[~is_pair])
    matched = ~is_pair & (mate[j] >= 0)
    np.minimum.at(rival, mate[j[matched]], distance[matched])
    return np.asarray(rival > cost + _MIN_RIVAL_MARGIN)
