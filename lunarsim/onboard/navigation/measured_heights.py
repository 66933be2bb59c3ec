"""Correct rock heights by terrain heights that another sensor has measured.

A LiDAR measures the terrain relative to the lander. The height of the rocks below the lander, and
with it their range, is then known to decimetres, while images alone leave metres. In an oblique
view a height error of one metre is a horizontal error of more than one metre.

Terrain and rocks both depend on the estimated pose. With the measured height m at a rock, the
terrain normal n there (vertical component 1), and r the vector from the lander to the rock, the
true errors (estimate plus error is truth) satisfy

    m - z = n d(rock) - n d(position) - (r x n) d(attitude) + noise.

Attitude errors are about body axes, so r and n are expressed in body axes in that term. The noise
has an independent part per rock and a part common to all rocks of one scan.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from lunarsim._blas import one_blas_thread
from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.error_state import POSE, ErrorState, UpdateOutcome
from lunarsim.typing import Array, IntArray

# Individual and common standard deviation of a rock's height on measured terrain, m.
INDIVIDUAL_SIGMA_M, COMMON_SIGMA_M = 0.15, 0.15
# Minimum ratio of the height variance of a rock to the noise variance for a correction.
_MIN_VARIANCE_RATIO = 2.0
# Maximum number of corrected rocks; those with the largest variance are used.
_MAX_ROCKS = 100
# Maximum normalised innovation squared per degree of freedom.
_GATE = 10.0
# Half distance of the points for a slope, m; each height is a mean over 2 m.
_SLOPE_BASE_M = 4.0


class TerrainHeights(Protocol):
    """Interface of a source of measured terrain heights."""

    def heights(self, xy: Array) -> Array:
        """Return terrain heights (n,) at points (n, 2), local frame, m; NaN if unknown."""
        ...


class RockErrors(Protocol):
    """Interface of rocks whose positions are part of an error state (`RockStates`)."""

    state: ErrorState

    @property
    def xyz(self) -> Array:
        """Centres of the rocks on the terrain (n, 3), ENU, m."""
        ...

    @property
    def xy(self) -> Array:
        """Centres of the rocks (n, 2), east and north, m."""
        ...

    def state_indices(self, index: IntArray | None = None) -> IntArray:
        """Return the indices of the rocks' coordinates in the error state (n, 3).

        `index` (n,) selects rocks; default: all rocks.
        """
        ...


def correct_heights(rocks: RockErrors, terrain: TerrainHeights) -> UpdateOutcome:
    """Correct rock heights by terrain heights measured from the current pose.

    Rocks whose relative height is known equally well are not updated directly, but through their
    correlations. Call this once per scan, since the error of a scan is the same in repeated calls;
    a second call changes nothing for the corrected rocks.

    Parameters
    ----------
    rocks
        Rocks in the error state.
    terrain
        Source of the measured heights.

    Returns
    -------
    outcome
        Outcome of the update, with one degree of freedom per rock.
    """
    height = terrain.heights(rocks.xy)
    index = np.flatnonzero(np.isfinite(height))
    gradient, bend = _slope_and_curvature(terrain, rocks.xy[index])
    by_pose, by_rock = _jacobians(rocks.state, rocks.xyz[index], gradient)
    own = INDIVIDUAL_SIGMA_M**2 + bend**2
    nis_ratio = _variances(rocks, index, by_pose, by_rock) / (own + COMMON_SIGMA_M**2)
    order = np.argsort(-nis_ratio, kind="stable")[:_MAX_ROCKS]
    selected = order[nis_ratio[order] > _MIN_VARIANCE_RATIO]
    if not len(selected):
        return UpdateOutcome(0.0, 0, False)
    index, by_pose, by_rock = index[selected], by_pose[selected], by_rock[selected]
    state, columns = rocks.state, rocks.state_indices(index)
    p = state.covariance
    with one_blas_thread():
        hp = by_pose @ p[POSE] + np.einsum("ka,kas->ks", by_rock, p[columns])
        s = hp[:, POSE] @ by_pose.T + np.einsum("jka,ka->jk", hp[:, columns], by_rock)
    s = 0.5 * (s + s.T) + np.diag(own[selected]) + COMMON_SIGMA_M**2
    return state.update_with_innovation(
        hp, s, height[index] - rocks.xyz[index, 2], _GATE * len(index)
    )


def height_jacobian(state: ErrorState, point: Array) -> Array:
    """Return the Jacobian of a rock's measured height with respect to the pose (6,).

    `point` (3,) is the position of the rock, m. The terrain slope has no influence: a horizontal
    error moves the rock and the terrain alike.
    """
    by_pose, _ = _jacobians(state, point[None], np.zeros((1, 2)))
    return np.asarray(-by_pose[0])


def _jacobians(state: ErrorState, points: Array, gradient: Array) -> tuple[Array, Array]:
    """Return the Jacobians of height innovations with respect to pose and rocks.

    They are (k, 6) for the pose and (k, 3) for the position of each rock. `points` (k, 3), m, are
    the rocks, and `gradient` (k, 2) the terrain slopes there.
    """
    body = quat_to_matrix(state.inertial.attitude)
    normal = np.hstack((-gradient, np.ones((len(points), 1))))
    arm = (points - state.inertial.position) @ body
    return np.hstack((-normal, -np.cross(arm, normal @ body))), normal


def _variances(rocks: RockErrors, index: IntArray, by_pose: Array, by_rock: Array) -> Array:
    """Return the variance of each rock's height innovation without noise (k,), m^2.

    `index` (k,) are the rocks; `by_pose` (k, 6) and `by_rock` (k, 3) are their Jacobians.
    """
    p, columns = rocks.state.covariance, rocks.state_indices(index)
    both = np.hstack((by_pose, by_rock))
    at = np.hstack((np.broadcast_to(POSE, (len(index), len(POSE))), columns))
    own = p[at[:, :, None], at[:, None, :]]
    return np.asarray(np.einsum("ka,kab,kb->k", both, own, both))


def _slope_and_curvature(terrain: TerrainHeights, xy: Array) -> tuple[Array, Array]:
    """Return gradient (k, 2) and curvature height (k,), m, of measured terrain.

    The curvature height is the height error of a rock at a slightly wrong place. `xy` (k, 2), m,
    are the points. Both results are 0 if the terrain around the point is unknown.
    """
    gradient, bend = np.zeros((len(xy), 2)), np.zeros(len(xy))
    middle = terrain.heights(xy)
    for axis in range(2):
        step = _SLOPE_BASE_M * np.eye(2)[axis]
        more, less = terrain.heights(xy + step), terrain.heights(xy - step)
        known = np.isfinite(more - less)
        gradient[known, axis] = (more - less)[known] / (2.0 * _SLOPE_BASE_M)
        bend[known] = np.hypot(bend, 0.5 * (more + less) - middle)[known]
    return gradient, bend
