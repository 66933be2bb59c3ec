"""Threshold of p_safe that bounds the risk of the chosen sites, over worlds.

A calibrated probability holds on average over sites. The threshold here is calibrated on worlds: in
each, one site was chosen, from whatever number of sites, so the selection of the best site is
included. The method is learn then test (Angelopoulos et al., 2021, arXiv:2110.01052) with the
fixed sequence of all thresholds from the highest down, and exact binomial bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.evaluation.comparisons import share_upper_bound
from lunarsim.value_checks import check_shape


@dataclass(frozen=True)
class RiskThreshold:
    """Threshold above which a chosen site may be used, and the risk that it bounds.

    Attributes
    ----------
    threshold
        Minimum p_safe of a site that may be used; inf if no threshold has the required bound.
    worlds, used, failed
        Number of worlds, of worlds whose site reaches the threshold, and of failures among these.
    upper_bound
        Upper confidence bound of the risk: the probability that a world's site is used and fails.
    needed_worlds
        Number of worlds without any failure with which a threshold would exist.
    """

    threshold: float
    worlds: int
    used: int
    failed: int
    upper_bound: float
    needed_worlds: int


def risk_threshold(
    p_safe: ArrayLike, failed: ArrayLike, *, max_risk: float = 0.05, confidence: float = 0.95
) -> RiskThreshold:
    """Return the lowest threshold of p_safe that bounds the risk of the chosen sites.

    In a new world like the given ones, the probability that the chosen site reaches the
    threshold and fails is at most `max_risk`. This holds with the stated confidence over
    the draw of the given worlds, which must be independent draws from the same distribution.

    The bound needs no correction for the number of thresholds: a lower threshold never has a lower
    risk, so thresholds are tested from the highest down, and the first that fails ends the test.

    Parameters
    ----------
    p_safe
        p_safe of the site chosen in each world (n,). NaN: no site was chosen, which is no failure;
        inf: the world counts at every threshold.
    failed
        Whether this site is unsafe, or its landing failed (n,).
    max_risk
        Maximum risk, 0 to 1.
    confidence
        Confidence level, 0 to 1.

    Raises
    ------
    InputError
        If the arrays differ in length or are empty, or a level is not between 0 and 1.
    """
    for name, level in (("max_risk", max_risk), ("confidence", confidence)):
        if not 0.0 < level < 1.0:
            raise InputError(name, level, "must be between 0 and 1")
    p, bad = np.asarray(p_safe, np.float64), np.asarray(failed, np.bool_)
    if p.ndim != 1 or not p.size:
        raise InputError("p_safe", p.shape, "must have the shape (n,), with one value per world")
    check_shape("failed", bad, p.shape, "like p_safe")
    n = p.size
    # log1p(-x): the bound for no failure is 1 - (1 - confidence)^(1 / n).
    needed = math.ceil(math.log1p(-confidence) / math.log1p(-max_risk))
    found = RiskThreshold(math.inf, n, 0, 0, share_upper_bound(0, n, confidence), needed)
    for threshold in np.unique(p[np.isfinite(p)])[::-1]:
        used = p >= threshold
        count = int(np.count_nonzero(bad[used]))
        bound = share_upper_bound(count, n, confidence)
        if bound > max_risk:
            break
        found = RiskThreshold(
            float(threshold), n, int(np.count_nonzero(used)), count, bound, needed
        )
    return found
