"""Interpolate terrain heights by local ordinary kriging.

The terrain is modelled as an intrinsic random field: the variance of a height difference grows
linearly with the distance, independent of the height itself. Ordinary kriging (Matheron 1963) gives
the height of a point as a weighted mean of its neighbours' heights, with the error variance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim._jit import threads_for
from lunarsim.onboard.navigation import _kriging_kernels as kernels

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Standard deviation of rock heights at the same place, m: burial depth and relief within a metre.
_LOCAL_HEIGHT_SIGMA_M = 0.05
# Number of neighbours in the interpolation; they screen off all others.
NEIGHBOUR_COUNT = 5


def kriging_weights(places: Array, at: Array, growth: float) -> tuple[Array, Array]:
    """Return ordinary-kriging weights and variances of terrain heights at points.

    Parameters
    ----------
    places
        Horizontal positions of the neighbours of each point (b, k, 2), m.
    at
        Points to interpolate at (b, 2), m.
    growth
        Growth of the variance of a height difference with distance, m^2/m.

    Returns
    -------
    weights
        Weights of the neighbours' heights (b, k); their sum is 1.
    variance
        Kriging variance (b,), m^2.
    """
    b, k = places.shape[:2]
    gap = _lengths(places[:, :, None] - places[:, None])
    away = _lengths(places - at[:, None])
    system = np.ones((b, k + 1, k + 1))
    system[:, :k, :k] = (0.5 * growth * gap + _LOCAL_HEIGHT_SIGMA_M**2) * (1.0 - np.eye(k))
    system[:, k, k] = 0.0
    right = np.ones((b, k + 1))
    right[:, :k] = 0.5 * growth * away + _LOCAL_HEIGHT_SIGMA_M**2
    found = np.linalg.solve(system, right[..., None])[..., 0]
    return found[:, :k], np.einsum("bk,bk->b", found, right)


def _lengths(way: Array) -> Array:
    """Return the lengths of vectors (..., 2)."""
    return np.sqrt(way[..., 0] ** 2 + way[..., 1] ** 2)


def interpolate_heights(places: Array, known: Array, at: Array, growth: float) -> Array:
    """Interpolate terrain heights (b,), m, at points `at` (b, 2), m, by kriging.

    The known heights are `known` (n,), m, at `places` (n, 2), m. `growth` is the growth of the
    variance of a height difference with distance, m^2/m. Points that are not finite give NaN.
    """
    with threads_for(0.7 * len(at)):
        return np.asarray(
            kernels.interpolate_heights(
                np.ascontiguousarray(places, np.float64), np.ascontiguousarray(known, np.float64),
                np.ascontiguousarray(at, np.float64), min(NEIGHBOUR_COUNT, len(places)),
                float(growth),
                _LOCAL_HEIGHT_SIGMA_M,
            )
        )  # fmt: skip


def intersect_lines(
    places: Array,
    known: Array,
    origin: Array,
    per_drop: Array,
    height: Array,
    growth: float,
    search: tuple[int, float, float, float],
) -> Array:
    """Return the intersections of lines of sight with kriged terrain (b, 3), m.

    Parameters
    ----------
    places, known, growth
        Horizontal positions (n, 2), m, and terrain heights there (n,), m; growth of the variance of
        a height difference with distance, m^2/m.
    origin
        Start of the lines (3,), m.
    per_drop
        Horizontal advance of the lines, east and north, per metre of drop (b, 2).
    height
        Initial heights of the iteration (b,), m.
    search
        Maximum number of iterations; height tolerance, m; minimum and maximum factor of a step
        relative to the last height difference.
    """
    with threads_for(2.0 * len(height)):
        return np.asarray(
            kernels.intersect_lines(
                np.ascontiguousarray(places, np.float64), np.ascontiguousarray(known, np.float64),
                np.ascontiguousarray(origin, np.float64),
                np.ascontiguousarray(per_drop, np.float64),
                np.ascontiguousarray(height, np.float64), search,
                min(NEIGHBOUR_COUNT, len(places)), float(growth), _LOCAL_HEIGHT_SIGMA_M,
            )
        )  # fmt: skip
