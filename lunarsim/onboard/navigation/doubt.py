"""How what is doubted grows in a covariance, so that nothing is learnt by doubting."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from lunarsim.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Two errors that are the same but for this share of their variance are so by rounding.
_SINGULAR = 1e-9


def inflate(p: Array, columns: ArrayLike, factor: float, most: ArrayLike) -> None:
    """Multiply the variances of some errors by a factor, as far as no other tells of them.

    An error is what the others make of it and a rest; the rest grows, all of it alike, so that what
    these errors have to do with each other and with the others stays. Had they grown whole, a
    measurement of how they differ from one that did not would tell them both: two heights of 5 m
    that are known to be the same to 2 cm, one of them doubled, are told by the next look at their
    difference to be nothing.

    Parameters
    ----------
    p
        Covariance (n, n), changed in place.
    columns
        Distinct places in it (k,).
    factor
        1 or more.
    most
        Deviations (k,), or one for all, beyond which none grows.

    Raises
    ------
    InputError
        If the factor is less than 1 or no number, or a deviation is negative or none.
    """
    if not 1.0 <= factor < np.inf:
        raise InputError("factor", factor, "a number of 1 or more")
    if not (np.asarray(most) >= 0.0).all():
        raise InputError("most", most, "deviations that are not negative")
    at = np.asarray(columns, dtype=np.int64)
    told = _told_by_others(p, at)
    own = p[np.ix_(at, at)]
    rest = own - told
    # Where rounding has eaten a variance all is refused; what is left is not spoilt besides.
    variance = np.maximum(rest.diagonal(), 0.0)
    room = np.square(most) - np.maximum(told.diagonal(), 0.0)
    times = np.sqrt(np.clip(room / np.maximum(variance, 1e-300), 1.0, factor))
    p[np.ix_(at, at)] = own + (np.outer(times, times) - 1.0) * rest


def _told_by_others(p: Array, at: Index) -> Array:
    """Return the covariance of what all other errors tell of some (k, k)."""
    others = np.setdiff1d(np.arange(len(p)), at)
    unit = np.sqrt(np.maximum(p.diagonal()[others], 1e-300))
    cross = p[np.ix_(at, others)] / unit
    correlation = p[np.ix_(others, others)] / np.outer(unit, unit)
    correlation.flat[:: len(others) + 1] += _SINGULAR
    try:
        found = cross @ cho_solve(cho_factor(correlation), cross.T)
    except (np.linalg.LinAlgError, ValueError):
        # Not positive or not finite: everything is refused from now on, whatever grows.
        return np.zeros((len(at), len(at)))
    return np.asarray(0.5 * (found + found.T))
