"""Associate detections with tracked rocks, and check the rocks that result."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import cKDTree
from scipy.special import pdtr

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation.matrix_2x2 import largest_eigenvalue_2x2, squared_mahalanobis_2x2
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.shadow_model import ShadowPatch
from lunarsim.typing import Array, BoolArray, IntArray

# 99.9 % quantile of chi-squared with 3 degrees of freedom (pixel and radius).
GATE = 16.27
# Minimum margin of the squared distance of the next candidate for an unambiguous pair.
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
) -> tuple[IntArray, IntArray, BoolArray, BoolArray]:
    """Assign detections to tracked rocks by minimum Mahalanobis distance.

    The sum of the squared distances of all pairs is minimized. An unpaired detection costs `gate`,
    so no pair has a larger distance.

    Parameters
    ----------
    pixel, pixel_covariance, radius, radius_variance
        Detected positions (d, 2), pixels, their covariances (d, 2, 2), radii (d,), m, and radius
        variances (d,), m^2.
    predicted, predicted_covariance, tracked_radius, tracked_variance
        Predicted positions of the rocks (t, 2), pixels, their covariances (t, 2, 2), radii (t,), m,
        and radius variances (t,), m^2.
    gate
        Maximum squared distance of a pair.

    Returns
    -------
    detection, rock
        Indices of the pairs (p,), ascending by detection.
    is_unambiguous
        Whether each pair has no rival at nearly the same distance (p,): neither another detection
        for the rock nor another rock for the detection.
    is_gated
        Whether each detection is within the gate of any rock (d,).
    """
    none = np.empty(0, np.int64)
    d, t = len(pixel), len(predicted)
    if d == 0 or t == 0:
        return none, none, np.zeros(0, bool), np.zeros(d, bool)
    spread = np.sqrt(
        largest_eigenvalue_2x2(predicted_covariance).max()
        + largest_eigenvalue_2x2(pixel_covariance)
    )
    i, j = _neighbours(pixel, predicted, np.sqrt(gate) * spread)
    offset = pixel[i] - predicted[j]
    s = pixel_covariance[i] + predicted_covariance[j]
    distance = squared_mahalanobis_2x2(offset, s)
    distance += (radius[i] - tracked_radius[j]) ** 2 / (radius_variance[i] + tracked_variance[j])
    inside = distance < gate
    i, j, distance = i[inside], j[inside], distance[inside]
    is_gated = np.zeros(d, bool)
    is_gated[i] = True
    detection, rock = _optimal_pairs(i, j, distance, d, t, gate)
    rock_of = np.full(d, -1)
    rock_of[detection] = rock
    detection_of = np.full(t, -1)
    detection_of[rock] = detection
    is_unambiguous = _is_unambiguous(i, j, distance, rock_of, detection_of)
    return detection, rock, is_unambiguous[detection], is_gated


def _neighbours(points: Array, others: Array, reach: Array) -> tuple[IntArray, IntArray]:
    """Return the index pairs (i, j) of points and others that are close to each other.

    `points` (d, 2) and `others` (t, 2) are close if their distance is below `reach` (d,).
    """
    near = cKDTree(others).query_ball_point(points, reach)
    i = np.repeat(np.arange(len(points)), [len(n) for n in near])
    return i, np.fromiter(chain.from_iterable(near), np.int64, i.size)


def _optimal_pairs(
    i: IntArray,
    j: IntArray,
    distance: Array,
    detection_count: int,
    rock_count: int,
    unpaired_cost: float,
) -> tuple[IntArray, IntArray]:
    """Return the pairs (detection, rock) of minimum total cost.

    `i`, `j` and `distance` are detection, rock and squared distance of the candidate pairs. Each
    unpaired detection adds `unpaired_cost`.
    """
    # One column per detection stands for "unpaired"; weights must not be 0, which means absent.
    each = np.arange(detection_count)
    cost = csr_array(
        (
            np.concatenate((distance, np.full(detection_count, unpaired_cost))) + 1.0,
            (np.concatenate((i, each)), np.concatenate((j, rock_count + each))),
        ),
        shape=(detection_count, rock_count + detection_count),
    )
    rows, column = min_weight_full_bipartite_matching(cost)
    paired = column < rock_count
    return np.asarray(rows[paired], np.int64), np.asarray(column[paired], np.int64)


def _is_unambiguous(
    i: IntArray, j: IntArray, distance: Array, rock_of: IntArray, detection_of: IntArray
) -> BoolArray:
    """Return which detections (d,) are much closer to their rock than any rival.

    `i`, `j` and `distance` are detection, rock and squared distance of the candidate pairs.
    `rock_of` is the rock of each detection (d,) and `detection_of` the detection of each rock (t,),
    -1 for none.
    """
    cost = np.full(len(rock_of), np.inf)
    is_pair = rock_of[i] == j
    cost[i[is_pair]] = distance[is_pair]
    # A rival is the same detection with another rock, or the same rock with another detection.
    rival = np.full(len(rock_of), np.inf)
    np.minimum.at(rival, i[~is_pair], distance[~is_pair])
    matched = ~is_pair & (detection_of[j] >= 0)
    np.minimum.at(rival, detection_of[j[matched]], distance[matched])
    return np.asarray(rival > cost + _MIN_RIVAL_MARGIN)


def is_dark_at_patch(
    rocks: RockFilter,
    index: IntArray,
    unit_patches: ShadowPatch,
    detections: Detections,
    camera: CameraModel,
    sun: Array,
    plane: GroundPlane,
) -> BoolArray:
    """Return whether an image is dark where the shadow of each rock is expected (n,).

    `rocks` is the filter of the tracked rocks and `index` (n,) selects the rocks. `unit_patches`
    are the expected dark patches of rocks of radius 1 m at their positions. `detections` holds the
    dark patches of the image. `sun` (3,) is the direction towards the Sun, ENU, and `plane` the
    plane on which shadows fall. For a shadow out of view, the nearest pixel at the edge is tested.
    """
    s = np.array([sun[0], sun[1]]) / np.hypot(sun[0], sun[1])
    offset = np.stack((unit_patches.along, unit_patches.across), -1) @ np.array(
        [[s[0], s[1]], [-s[1], s[0]]]
    )
    middle = rocks.xyz[index]
    offset *= rocks.radius[index, None]
    middle += np.column_stack((offset, offset @ np.array(plane.gradient)))
    u, v = np.rint(rocks.project_rocks(camera, middle).pixel).T
    u = np.clip(u, 0, camera.width - 1).astype(int)
    v = np.clip(v, 0, camera.height - 1).astype(int)
    return np.asarray(detections.labels[v, u] > 0)


@dataclass(frozen=True)
class TentativeRocks:
    """Detections of the last image that are not tracked but may be rocks.

    They do not start a track, for instance because they are too inaccurate or too small.

    Attributes
    ----------
    xy
        Centres (n, 2), m.
    sigma
        Position error, root of the mean variance of both axes (n,), m.
    radius, radius_variance
        Radius (n,), m, and its variance, m^2.
    existence
        Probability that each is a rock (n,).
    """

    xy: Array
    sigma: Array
    radius: Array
    radius_variance: Array
    existence: Array

    @classmethod
    def none(cls) -> TentativeRocks:
        """Return an object without any detection."""
        empty = np.empty(0)
        return cls(np.empty((0, 2)), empty, empty, empty, empty)


# The number is too low if it is below this fraction of the expected number and its probability is
# below this value.
_MIN_FOUND_FRACTION, _MAX_CHANCE = 0.25, 1e-6


def is_rock_count_too_low(found: int, expected: float) -> bool:
    """Return whether far fewer rocks were found than expected.

    This is the case if fewer than a quarter were found and the Poisson probability of so few is
    below 1e-6. Either the terrain has fewer rocks, or they are not detected.

    Parameters
    ----------
    found, expected
        Number of rocks found, and number expected from the size distribution and detection rates.
    """
    return bool(found < _MIN_FOUND_FRACTION * expected and pdtr(found, expected) < _MAX_CHANCE)
