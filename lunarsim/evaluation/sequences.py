"""Intervals that hold however often one looks: confidence sequences of a share.

A Wilson interval holds for a number of trials that was fixed beforehand. Who looks at it after
every flight and stops when it suits him is wrong more often than it says. A confidence sequence
holds for all numbers of trials at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable

# Halvings of an interval in (0, 1); SciPy's root finders take seconds to load for as much.
_HALVINGS = 60


def share_sequence(count: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return the interval after `total` trials with `count` successes.

    The shares that a betting game against them with Beta(1/2, 1/2) mixed stakes has not refuted:
    those at which the mixed likelihood is less than 1 / (1 - level) times their own (Ville's
    inequality; Robbins 1970, Ann. Math. Statist. 41, 1397; the mixture is Jeffreys').

    Raises
    ------
    ValueError
        If `count` is not between 0 and `total`.

    Examples
    --------
    >>> low, high = share_sequence(18, 20)
    >>> round(low, 3), round(high, 3)
    (0.591, 0.996)
    """
    if not 0 <= count <= total:
        raise ValueError(f"count = {count}: from 0 to {total}")
    if total == 0:
        return 0.0, 1.0
    failures = total - count
    mixed = _log_beta(count + 0.5, failures + 0.5) - _log_beta(0.5, 0.5)
    limit = mixed + math.log(1.0 - level)

    def kept(p: float) -> bool:
        likelihood = count * math.log(p) if count else 0.0
        return likelihood + (failures * math.log1p(-p) if failures else 0.0) > limit

    middle = count / total
    low = 0.0 if count == 0 else _edge(kept, middle, 0.0)
    high = 1.0 if failures == 0 else _edge(kept, middle, 1.0)
    return low, high


def _edge(kept: Callable[[float], bool], inside: float, outside: float) -> float:
    """Return where shares stop being kept, between one that is and an end of (0, 1)."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        if middle in (inside, outside):
            break
        if kept(middle):
            inside = middle
        else:
            outside = middle
    return outside


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
