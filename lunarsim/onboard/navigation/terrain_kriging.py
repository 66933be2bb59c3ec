"""Interpolate terrain heights by local ordinary kriging.

The terrain is modelled as an intrinsic random field: the variance of a height difference grows
linearly with the distance, independent of the height itself. Ordinary kriging (Matheron 1963) gives
the height of a point as a weighted mean of its neighbours' heights, with the error variance.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import threads_for
from lunarsim.onboard.navigation import _kriging_kernels as kernels
from lunarsim.typing import Array

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
        Maximum number of iterations; height tolerance, m; minimum and maximum factor of a step
        relative to the last height difference.
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
