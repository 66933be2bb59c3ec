"""Sums of bent lines: what a logistic regression adds up of each thing that it is told.

A term bends at its knots; each interval between two of them is a feature, how much of it the value
has passed. Weights that are not negative make the sum rise with the value, or fall with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


def score(terms: Sequence[Term], weights: Array) -> Array:
    """Return ``columns(terms) @ weights`` (n,) without the columns."""
    total: Array = np.zeros(())
    at = 0
    for term in terms:
        own = weights[at : at + len(term.knots) - 1]
        at += len(own)
        risen = np.concatenate(([0.0], np.cumsum(own)))
        height = risen[-1] - risen if term.falls else risen
        total = total + np.interp(term.values, term.knots, height)
    return total
