"""Terrain heights: prior knowledge, local ordinary kriging, and corrections.

The terrain is modelled as an intrinsic random field: the variance of a height difference grows
linearly with the distance, independent of the height itself. Ordinary kriging (Matheron 1963) gives
the height of a point as a weighted mean of its neighbours' heights, with the error variance.

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

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lunarsim._blas import one_blas_thread
from lunarsim._jit import threads_for
from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.messages.briefing import Briefing
from lunarsim.models.gravity import CentralGravity
from lunarsim.onboard.navigation import _kriging_kernels as kernels
from lunarsim.onboard.navigation.error_state import POSE, ErrorState, UpdateOutcome
from lunarsim.typing import Array, IntArray
from lunarsim.value_checks import check_finite

# Name of the block of the terrain height relative to the target elevation, and the length (m) that
# scales its random walk: over this distance heights differ by the slope times this length.
TERRAIN = "ground"
_LENGTH_SCALE_M = 10.0
# Exponent of the height difference over a distance in metres, for a slope measured over 1 m: lunar
# mare up to a kilometre (Rosenburg et al. 2011; highland is rougher, 0.95).
_HURST_EXPONENT = 0.76
# Minimum standard deviation of the terrain height, m.
_MIN_HEIGHT_SIGMA_M = 0.1


@dataclass(frozen=True)
class TerrainPrior:
    """Prior estimate of the terrain height, used to interpret ranges to the terrain.

    Attributes
    ----------
    elevation
        Estimated elevation of the terrain, m.
    sigma
        Standard deviation of the terrain height below the initial position, m; if None, the
        elevation is exact everywhere.
    relief
        Tangent of the typical terrain slope.
    radius
        Radius of the Moon, m, whose curvature lowers distant terrain; infinite: flat.
    """

    elevation: float = 0.0
    sigma: float | None = 10.0
    relief: float = float(np.tan(np.deg2rad(5.0)))
    radius: float = np.inf

    def __post_init__(self) -> None:
        for name, value in (("sigma", self.sigma), ("relief", self.relief)):
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"terrain_prior.{name}", value, "must be 0 or more, and finite")
        check_finite("terrain_prior.elevation", self.elevation)

    @classmethod
    def of(cls, briefing: Briefing, relief: float) -> TerrainPrior:
        """Return the prior terrain height below the initial position of a flight.

        The estimate is the target elevation. Its error combines the elevation error stated in the
        briefing and the height difference over the distance to the target; `relief` is the tangent
        of the slope over 1 m.
        """
        distance = float(np.linalg.norm((briefing.start.position - briefing.target)[:2]))
        rise = relief * distance**_HURST_EXPONENT
        sigma = float(np.hypot(briefing.start.target_elevation_sigma, rise))
        gravity = briefing.gravity
        radius = gravity.radius if isinstance(gravity, CentralGravity) else np.inf
        return cls(float(briefing.target[2]), max(sigma, _MIN_HEIGHT_SIGMA_M), relief, radius)

    def elevation_at(self, xy: Array) -> float:
        """Return the estimated terrain elevation, m, at a point (2,), local, m."""
        return self.elevation - float(xy @ xy) / (2.0 * self.radius)

    @property
    def growth(self) -> float:
        """Growth of the variance of a terrain-height difference with distance, m^2/m."""
        return self.relief**2 * _LENGTH_SCALE_M


# Standard deviation of rock heights at the same place, m: burial depth and relief within a metre.
_LOCAL_HEIGHT_SIGMA_M = 0.05
# Number of neighbours in the interpolation; they screen off all others.
NEIGHBOUR_COUNT = 5


def kriging_weights(
    neighbour_xy: Array, query_xy: Array, variance_growth: float
) -> tuple[Array, Array]:
    """Return ordinary-kriging weights and variances of terrain heights at points.

    Parameters
    ----------
    neighbour_xy
        Horizontal positions of the k neighbours of each point (b, k, 2), m.
    query_xy
        Points to interpolate at (b, 2), m.
    variance_growth
        Growth of the variance of a height difference with distance, m^2/m.

    Returns
    -------
    weights
        Weights of the neighbours' heights (b, k); their sum is 1.
    variance
        Kriging variance (b,), m^2.
    """
    b, k = neighbour_xy.shape[:2]
    separation = _lengths(neighbour_xy[:, :, None] - neighbour_xy[:, None])
    distance = _lengths(neighbour_xy - query_xy[:, None])
    system = np.ones((b, k + 1, k + 1))
    system[:, :k, :k] = (0.5 * variance_growth * separation + _LOCAL_HEIGHT_SIGMA_M**2) * (
        1.0 - np.eye(k)
    )
    system[:, k, k] = 0.0
    right = np.ones((b, k + 1))
    right[:, :k] = 0.5 * variance_growth * distance + _LOCAL_HEIGHT_SIGMA_M**2
    found = np.linalg.solve(system, right[..., None])[..., 0]
    return found[:, :k], np.einsum("bk,bk->b", found, right)


def _lengths(vectors: Array) -> Array:
    """Return the lengths of vectors (..., 2)."""
    return np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2)


def interpolate_heights(
    known_xy: Array, known_height: Array, query_xy: Array, variance_growth: float
) -> Array:
    """Interpolate terrain heights (b,), m, at points `query_xy` (b, 2), m, by kriging.

    The known heights are `known_height` (n,), m, at `known_xy` (n, 2), m. `variance_growth` is the
    growth of the variance of a height difference with distance, m^2/m. Points that are not finite
    give NaN.
    """
    with threads_for(0.7 * len(query_xy)):
        return np.asarray(
            kernels.interpolate_heights(
                np.ascontiguousarray(known_xy, np.float64),
                np.ascontiguousarray(known_height, np.float64),
                np.ascontiguousarray(query_xy, np.float64),
                min(NEIGHBOUR_COUNT, len(known_xy)),
                float(variance_growth),
                _LOCAL_HEIGHT_SIGMA_M,
            )
        )


def intersect_lines(
    known_xy: Array,
    known_height: Array,
    origin: Array,
    per_drop: Array,
    start_height: Array,
    variance_growth: float,
    iteration_limits: tuple[int, float, float, float],
) -> Array:
    """Return the intersections of lines of sight with kriged terrain (b, 3), m.

    Parameters
    ----------
    known_xy, known_height, variance_growth
        Horizontal positions (n, 2), m, and terrain heights there (n,), m; growth of the variance of
        a height difference with distance, m^2/m.
    origin
        Start of the lines (3,), m.
    per_drop
        Horizontal advance of the lines, east and north, per metre of drop (b, 2).
    start_height
        Initial heights of the iteration (b,), m.
    iteration_limits
        Maximum number of iterations; height tolerance, m; minimum and maximum decrease of the
        height difference per metre of height, by which the difference is divided for a step.
    """
    with threads_for(2.0 * len(start_height)):
        return np.asarray(
            kernels.intersect_lines(
                np.ascontiguousarray(known_xy, np.float64),
                np.ascontiguousarray(known_height, np.float64),
                np.ascontiguousarray(origin, np.float64),
                np.ascontiguousarray(per_drop, np.float64),
                np.ascontiguousarray(start_height, np.float64),
                iteration_limits,
                min(NEIGHBOUR_COUNT, len(known_xy)),
                float(variance_growth),
                _LOCAL_HEIGHT_SIGMA_M,
            )
        )


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
    are the points. Along an axis on which the terrain around the point is unknown, the gradient is
    0 and the curvature height gets no contribution.
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
