"""Sums of bent lines: what a logistic regression adds up of each thing that it is told.

A term bends at its knots; each interval between two of them is a feature, how much of it the value
has passed. Weights that are not negative make the sum rise with the value, or fall with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.safety import _bend_kernels as k

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Term:
    """One thing that is known of each site.

    Attributes
    ----------
    values
        (n,), or () where all sites share it; not NaN.
    knots
        Rising (k,).
    falls
        Whether more of it speaks against the site.
    """

    values: Array
    knots: Array
    falls: bool = True


def columns(terms: Sequence[Term], n: int) -> Array:
    """Return the features of n sites (n, sum of the terms' k - 1), each in [0, 1]."""
    out = []
    for term in terms:
        low, high = term.knots[:-1], term.knots[1:]
        values = np.broadcast_to(term.values, n)[:, None]
        passed = np.clip((values - low) / (high - low), 0.0, 1.0)
        out.append(1.0 - passed if term.falls else passed)
    return np.column_stack(out)


def extremes(terms: Sequence[Term], base: Array, weights: Array) -> tuple[Array, Array]:
    """Return the least and the greatest of ``base + columns(terms) @ weights.T`` (n,) each.

    Parameters
    ----------
    terms
        Of n sites; at least one has a value for each.
    base
        What each fit begins with, at all sites (fits,) or each (n, fits).
    weights
        Of the fits (fits, sum of the terms' k - 1).
    """
    base = np.atleast_2d(np.asarray(base, dtype=np.float64))
    values, knots, heights = [], [], []
    at = 0
    for term in terms:
        own = weights[:, at : at + len(term.knots) - 1]
        at += own.shape[1]
        risen = np.concatenate((np.zeros((len(own), 1)), np.cumsum(own, axis=1)), axis=1)
        height = (risen[:, -1:] - risen if term.falls else risen).T
        if np.ndim(term.values) == 0:
            base = base + [np.interp(term.values, term.knots, h) for h in height.T]
            continue
        values.append(term.values)
        knots.append(term.knots)
        heights.append(height)
    first = np.concatenate(([0], np.cumsum([len(x) for x in knots])))
    low, high = np.empty(len(values[0])), np.empty(len(values[0]))
    k.extremes(
        np.ascontiguousarray(base), np.array(values, dtype=np.float64), np.concatenate(knots),
        first, np.ascontiguousarray(np.concatenate(heights)), low, high,
    )  # fmt: skip
    return low, high
