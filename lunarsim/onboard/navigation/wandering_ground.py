"""Heights of ground that rises and falls: what is known of one place from others.

The difference of the heights of two places has a variance that grows with the distance between
them, whatever the level: an intrinsic random field. Ordinary kriging (Matheron 1963) gives the
height of a place as a weighted mean of those of its neighbours, and what that errs by.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim._jit import threads_for
from lunarsim.onboard.navigation import _ground_kernels as kernels

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Heights of rocks side by side differ by as much, m: how deep they lie, and what the ground does
# within a metre.
_OWN = 0.05
# So many neighbours screen off the others.
NEIGHBOURS = 5


def kriging(places: Array, at: Array, growth: float) -> tuple[Array, Array]:
    """Return what heights at some places tell of the height elsewhere.

    Parameters
    ----------
    places
        Neighbours of each point (b, k, 2), m.
    at
        Points (b, 2), m.
    growth
        By how much the variance of the difference of two heights grows with a metre between them,
        m^2/m.

    Returns
    -------
    weights
        Of the neighbours (b, k), their sum being 1.
    variance
        Of what the height is besides that mean (b,), m^2.
    """
    b, k = places.shape[:2]
    gap = _lengths(places[:, :, None] - places[:, None])
    away = _lengths(places - at[:, None])
    system = np.ones((b, k + 1, k + 1))
    system[:, :k, :k] = (0.5 * growth * gap + _OWN**2) * (1.0 - np.eye(k))
    system[:, k, k] = 0.0
    right = np.ones((b, k + 1))
    right[:, :k] = 0.5 * growth * away + _OWN**2
    found = np.linalg.solve(system, right[..., None])[..., 0]
    return found[:, :k], np.einsum("bk,bk->b", found, right)


def _lengths(way: Array) -> Array:
    """Return the lengths of vectors (..., 2)."""
    return np.sqrt(way[..., 0] ** 2 + way[..., 1] ** 2)


def heights(places: Array, known: Array, at: Array, growth: float) -> Array:
    """Return the likeliest heights (b,) at points (b, 2) from those known (n,) at places (n, 2).

    NaN at points that are not finite.
    """
    with threads_for(0.7 * len(at)):
        return np.asarray(
            kernels.heights(
                np.ascontiguousarray(places, np.float64), np.ascontiguousarray(known, np.float64),
                np.ascontiguousarray(at, np.float64), min(NEIGHBOURS, len(places)), float(growth),
                _OWN,
            )
        )  # fmt: skip


def crossings(
    places: Array,
    known: Array,
    eye: Array,
    per_drop: Array,
    height: Array,
    growth: float,
    search: tuple[int, float, float, float],
) -> Array:
    """Return where lines of sight meet the ground that `heights` gives (b, 3).

    Parameters
    ----------
    places, known, growth
        As for `heights`.
    eye
        Where lines begin (3,), m.
    per_drop
        How far they go east and north for each metre that they go down (b, 2).
    height
        At which the search begins (b,), m.
    search
        Passes at most; up to how far off a height is right, m; by which factors a height may fall
        short of what was found there and go beyond.
    """
    with threads_for(2.0 * len(height)):
        return np.asarray(
            kernels.crossings(
                np.ascontiguousarray(places, np.float64), np.ascontiguousarray(known, np.float64),
                np.ascontiguousarray(eye, np.float64), np.ascontiguousarray(per_drop, np.float64),
                np.ascontiguousarray(height, np.float64), search,
                min(NEIGHBOURS, len(places)), float(growth), _OWN,
            )
        )  # fmt: skip
