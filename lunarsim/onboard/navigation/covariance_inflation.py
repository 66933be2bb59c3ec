"""Inflate variances in a covariance without adding information."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from lunarsim.errors import InputError
from lunarsim.typing import Array, IntArray
from lunarsim.value_checks import check_elements

# Relative variance added so that the correlation of nearly equal errors is positive definite.
_REGULARISATION = 1e-9


def inflate(p: Array, columns: ArrayLike, factor: float, max_sigma: ArrayLike) -> None:
    """Multiply the conditional variances of some errors in a covariance by a factor.

    Each error is the sum of its regression on the other errors and a residual. Only the residual is
    inflated, so that the correlations remain valid. If the total variance were inflated, a later
    measurement of a difference would create information. Example: two heights have standard
    deviations of 5 m and are known to be equal to 2 cm. If one variance is inflated in full, a
    measurement of their difference makes both seem known to be near zero.

    Parameters
    ----------
    p
        Covariance (n, n), changed in place.
    columns
        Distinct indices of the errors (k,).
    factor
        Factor on the variances, 1 or more.
    max_sigma
        Maximum standard deviations (k,) after the inflation, or one for all.

    Raises
    ------
    InputError
        If the factor is below 1 or not finite, or a standard deviation is negative or NaN.
    """
    if not 1.0 <= factor < np.inf:
        raise InputError("factor", factor, "must be 1 or more, and finite")
    check_elements("max_sigma", max_sigma, np.asarray(max_sigma) >= 0.0, "must be 0 or more")
    at = np.asarray(columns, dtype=np.int64)
    explained = _explained_covariance(p, at)
    covariance = p[np.ix_(at, at)]
    residual = covariance - explained
    # If rounding made a variance negative, all updates are rejected anyway; do not worsen it here.
    variance = np.maximum(residual.diagonal(), 0.0)
    headroom = np.square(max_sigma) - np.maximum(explained.diagonal(), 0.0)
    scale = np.sqrt(np.clip(headroom / np.maximum(variance, 1e-300), 1.0, factor))
    p[np.ix_(at, at)] = covariance + (np.outer(scale, scale) - 1.0) * residual


def _explained_covariance(p: Array, indices: IntArray) -> Array:
    """Return the covariance (k, k) of some errors explained by all other errors.

    This is the covariance of the regression of the errors `indices` (k,) on the others; `p` (n, n)
    is the covariance of all errors.
    """
    others = np.setdiff1d(np.arange(len(p)), indices)
    unit = np.sqrt(np.maximum(p.diagonal()[others], 1e-300))
    cross = p[np.ix_(indices, others)] / unit
    correlation = p[np.ix_(others, others)] / np.outer(unit, unit)
    correlation.flat[:: len(others) + 1] += _REGULARISATION
    try:
        explained = cross @ cho_solve(cho_factor(correlation), cross.T)
    except (np.linalg.LinAlgError, ValueError):
        # Not positive definite or not finite: all later measurements are rejected in any case.
        return np.zeros((len(indices), len(indices)))
    return np.asarray(0.5 * (explained + explained.T))
