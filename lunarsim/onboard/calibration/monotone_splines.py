"""Monotone piecewise linear terms of a logistic regression.

A term has knots; each interval between two knots is a feature, the fraction of the interval below
the value. With non-negative weights the sum is monotone in the value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsim.onboard.calibration import _monotone_spline_kernels as k
from lunarsim.typing import Array


@dataclass(frozen=True)
class MonotoneSplineTerm:
    """One explanatory variable of the regression, with the knots of its spline.

    Attributes
    ----------
    values
        Value of the variable for each site (n,), or () if equal for all sites; not NaN.
    knots
        Increasing knots (k,).
    is_decreasing
        Whether the probability of safety decreases with the value.
    """

    values: Array
    knots: Array
    is_decreasing: bool = True


def spline_features(terms: Sequence[MonotoneSplineTerm], n: int) -> Array:
    """Return the features of n sites from piecewise linear spline terms.

    The result is (n, sum of the terms' k - 1): for each interval between two of a term's k knots,
    the fraction of the interval below the value (above, if decreasing), in [0, 1].
    """
    out = []
    for term in terms:
        low, high = term.knots[:-1], term.knots[1:]
        values = np.broadcast_to(term.values, n)[:, None]
        passed = np.clip((values - low) / (high - low), 0.0, 1.0)
        out.append(1.0 - passed if term.is_decreasing else passed)
    return np.column_stack(out)


def ensemble_bounds(
    terms: Sequence[MonotoneSplineTerm], base: Array, weights: Array
) -> tuple[Array, Array]:
    """Return minimum and maximum over several fits of the log odds of n sites (n,).

    Parameters
    ----------
    terms
        Terms of n sites; at least one has a value for each site.
    base
        Log odds of each fit without the terms, for all sites (fits,) or each (n, fits).
    weights
        Weights of the fits (fits, sum of the terms' k - 1).
    """
    base = np.atleast_2d(np.asarray(base, dtype=np.float64))
    values, knots, heights = [], [], []
    at = 0
    for term in terms:
        own = weights[:, at : at + len(term.knots) - 1]
        at += own.shape[1]
        risen = np.concatenate((np.zeros((len(own), 1)), np.cumsum(own, axis=1)), axis=1)
        height = (risen[:, -1:] - risen if term.is_decreasing else risen).T
        if np.ndim(term.values) == 0:
            base = base + [np.interp(term.values, term.knots, h) for h in height.T]
            continue
        values.append(term.values)
        knots.append(term.knots)
        heights.append(height)
    first = np.concatenate(([0], np.cumsum([len(x) for x in knots])))
    low, high = np.empty(len(values[0])), np.empty(len(values[0]))
    k.fit_extremes(
        np.ascontiguousarray(base), np.array(values, dtype=np.float64), np.concatenate(knots),
        first, np.ascontiguousarray(np.concatenate(heights)), low, high,
    )  # fmt: skip
    return low, high
