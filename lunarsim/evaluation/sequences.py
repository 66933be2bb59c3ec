"""Compute confidence sequences of a share, valid at every number of trials.

A Wilson interval is valid for a number of trials fixed in advance. If one evaluates it after every
flight and stops at a favourable moment, its coverage is below the nominal level. A confidence
sequence covers all numbers of trials simultaneously.
"""

from __future__ import annotations

import math
from collections.abc import Callable

# Bisection steps in (0, 1); loading SciPy's root finders would take seconds.
_HALVINGS = 60


def share_confidence_sequence(count: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return an interval of a proportion that is valid at every number of trials.

    It is the confidence sequence after `total` trials with `count` successes.

    The interval contains the proportions p that a test by betting with a Beta(1/2, 1/2) mixture
    (Jeffreys) does not reject: the mixture likelihood is less than 1 / (1 - level) times the
    likelihood at p (Ville's inequality; Robbins 1970, Ann. Math. Statist. 41, 1397).

    Raises
    ------
    ValueError
        If `count` is not between 0 and `total`.

    Examples
    --------
    >>> low, high = share_confidence_sequence(18, 20)
    >>> round(low, 3), round(high, 3)
    (0.591, 0.996)
    """
    if not 0 <= count <= total:
        raise ValueError(f"count: must be between 0 and total ({total}), got {count}.")
    if total == 0:
        return 0.0, 1.0
    failures = total - count
    mixed = _log_beta(count + 0.5, failures + 0.5) - _log_beta(0.5, 0.5)
    limit = mixed + math.log(1.0 - level)

    def is_kept(p: float) -> bool:
        likelihood = count * math.log(p) if count else 0.0
        return likelihood + (failures * math.log1p(-p) if failures else 0.0) > limit

    middle = count / total
    low = 0.0 if count == 0 else _find_boundary(is_kept, middle, 0.0)
    high = 1.0 if failures == 0 else _find_boundary(is_kept, middle, 1.0)
    return low, high


def _find_boundary(is_kept: Callable[[float], bool], inside: float, outside: float) -> float:
    """Return the boundary between kept and rejected proportions by bisection.

    `is_kept` tests a proportion; `inside` is kept and `outside` is not.
    """
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        if middle in (inside, outside):
            break
        if is_kept(middle):
            inside = middle
        else:
            outside = middle
    return outside


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
