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
_RIVAL = 6.0


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
    near = cKDTree(predicted).query_ball_point(pixel, np.sqrt(gate) * spread)
    i = np.repeat(np.arange(d), [len(n) for n in near])
    j = np.fromiter(chain.from_iterable(near), np.int64, i.size)
    offset = pixel[i] - predicted[j]
    s = pixel_covariance[i] + predicted_covariance[j]
    distance = squared_distance(offset, s)
    distance += (radius[i] - tracked_radius[j]) ** 2 / (radius_variance[i] + tracked_variance[j])
    inside = distance < gate
    i, j, distance = i[inside], j[inside], distance[inside]
    close = np.zeros(d, bool)
    close[i] = True
    # One column a detection for "none of the rocks"; weights must not be 0, an absent entry.
    alone = np.arange(d)
    cost = csr_array(
        (
            np.concatenate((distance, np.full(d, gate))) + 1.0,
            (np.concatenate((i, alone)), np.concatenate((j, t + alone))),
        ),
        shape=(d, t + d),
    )
    rows, column = min_weight_full_bipartite_matching(cost)
    paired = column < t
    detection: Index = np.asarray(rows[paired], np.int64)
    rock: Index = np.asarray(column[paired], np.int64)
    own = np.full(d, -1)
    own[detection] = rock
    mate = np.full(t, -1)
    mate[rock] = detection
    cost_of = np.full(d, np.inf)
    is_pair = own[i] == j
    cost_of[i[is_pair]] = distance[is_pair]
    # A rival: the same detection with another rock, or the same rock with another detection.
    rival = np.full(d, np.inf)
    np.minimum.at(rival, i[~is_pair], distance[~is_pair])
    matched = ~is_pair & (mate[j] >= 0)
    np.minimum.at(rival, mate[j[matched]], distance[matched])
    sure = rival[detection] > cost_of[detection] + _RIVAL
    return detection, rock, np.asarray(sure), close
