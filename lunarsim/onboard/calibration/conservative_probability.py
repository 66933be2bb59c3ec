"""Conservative probability of a safe site from log odds of several fits.

The log odds are reduced by a margin for worlds that no fit includes, and the probability by a floor
on the probability of an unsafe site. Outside the domain of the fits a further bound applies.
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from lunarsim.typing import Array, BoolArray

# Margin on the log odds for worlds unlike those of the fits: a factor of 2 on the odds of an unsafe
# site.
LOG_ODDS_MARGIN = float(np.log(2.0))
# Minimum probability of an unsafe site. Half of the worlds of the fits have fewer than 750 almost
# certainly safe sites. A world in which 1 of 250 such sites is unsafe shows none among 750 in 1 of
# 20 cases.
MAX_CLAIM_DEFICIT = 0.004
# Sites count as almost certainly safe from this probability on.
ALMOST_CERTAINLY_SAFE_P = 0.95
# Sites count as almost certainly unsafe up to this probability.
ALMOST_CERTAINLY_UNSAFE_P = 0.05


def lower_bound_probability(
    low: Array, upper_bound: Array, margin: float = LOG_ODDS_MARGIN
) -> Array:
    """Return the safety probability (n,) from minimum log odds over the fits (n,).

    The log odds `low` are reduced by `margin`, the probability by the factor 1 -
    `MAX_CLAIM_DEFICIT`. The result is at most `upper_bound` (n,).
    """
    return np.asarray(np.minimum((1.0 - MAX_CLAIM_DEFICIT) * expit(low - margin), upper_bound))


def out_of_domain_bound(
    low: Array, upper_bound: Array, outside_bound: Array, margin: float
) -> Array:
    """Return the safety probability (n,) of sites outside the calibrated domain.

    `low` is the minimum log odds over the fits (n,), reduced by `margin`. The probability is at
    most `ALMOST_CERTAINLY_SAFE_P` times the lower of `upper_bound` and `outside_bound` (n,).
    """
    return np.asarray(
        ALMOST_CERTAINLY_SAFE_P
        * np.minimum(lower_bound_probability(low, upper_bound, margin), outside_bound)
    )


def conservative_probability(
    low: Array,
    upper_bound: Array,
    outside_bound: Array,
    in_domain: BoolArray,
    margin: float = LOG_ODDS_MARGIN,
) -> Array:
    """Return the safety probability (n,), limited outside the calibrated domain.

    A site in the domain with a probability of at least 0.95 (`ALMOST_CERTAINLY_SAFE_P`) keeps it.
    For all other sites, `margin` and `outside_bound` apply, and the probability is below 0.95.

    Parameters
    ----------
    low
        Minimum log odds over the fits (n,).
    upper_bound, outside_bound
        Upper bound of the probability of all sites, and further bound for sites that are outside
        the domain or not almost certainly safe (n,).
    in_domain
        Whether the sites are in the domain of the fits (n,).
    margin
        Margin on the log odds of the sites to which `outside_bound` applies.
    """
    plain = lower_bound_probability(low, upper_bound)
    return np.where(
        in_domain & (plain >= ALMOST_CERTAINLY_SAFE_P),
        plain,
        out_of_domain_bound(low, upper_bound, outside_bound, margin),
    )
