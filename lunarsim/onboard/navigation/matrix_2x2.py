"""Closed-form operations on many 2 x 2 matrices."""

from __future__ import annotations

import numpy as np

from lunarsim.typing import Array, BoolArray


def invert_2x2(a: Array) -> Array:
    """Return the inverses (n, 2, 2) of matrices (n, 2, 2).

    Singular matrices give elements that are not finite.
    """
    out = np.empty_like(a)
    out[:, 0, 0], out[:, 1, 1] = a[:, 1, 1], a[:, 0, 0]
    out[:, 0, 1], out[:, 1, 0] = -a[:, 0, 1], -a[:, 1, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(out / (a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * a[:, 1, 0])[:, None, None])


def largest_eigenvalue_2x2(a: Array) -> Array:
    """Return the largest eigenvalues (n,) of symmetric matrices (n, 2, 2)."""
    middle = 0.5 * (a[:, 0, 0] + a[:, 1, 1])
    return np.asarray(middle + np.hypot(0.5 * (a[:, 0, 0] - a[:, 1, 1]), a[:, 0, 1]))


def squared_mahalanobis_2x2(offset: Array, a: Array) -> Array:
    """Return squared Mahalanobis norms (n,) of offsets for covariances (n, 2, 2).

    `offset` (n, 2) are the offsets, and `a` (n, 2, 2) the covariances.
    """
    x, y = offset.T
    determinant = a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * a[:, 1, 0]
    square = a[:, 1, 1] * x * x - (a[:, 0, 1] + a[:, 1, 0]) * x * y + a[:, 0, 0] * y * y
    return np.asarray(square / determinant)


def is_positive_definite_2x2(covariance: Array) -> BoolArray:
    """Return which covariances (n, 2, 2) are finite and positive definite (n,)."""
    with np.errstate(invalid="ignore"):
        determinant = np.linalg.det(covariance)
        is_positive = (covariance[:, 0, 0] > 0.0) & (determinant > 0.0)
    return np.asarray(np.isfinite(covariance).all((1, 2)) & is_positive)
