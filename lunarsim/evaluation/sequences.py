"""Intervals that hold however often one looks: confidence sequences of a share.

A Wilson interval holds for a number of trials that was fixed beforehand. Who looks at it after
every flight and stops when it suits him is wrong more often than it says. A confidence sequence
holds for all numbers of trials at once.
"""

from __future__ import annotations

import math

from scipy.optimize import brentq
from scipy.special import betaln


def share_sequence(count: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return the interval after `total` trials with `count` successes.

    The shares that a betting game against them with Beta(1/2, 1/2) mixed stakes has not refuted:
    those at which the mixed likelihood is less than 1 / (1 - level) times their own (Ville's
    inequality; Robbins 1970, Ann. Math. Statist. 41, 1397; the mixture is Jeffreys').

    Raises
    ------
    ValueError
        If `count` is not between 0 and `total`.
    """
    if not 0 <= count <= total:
        raise ValueError(f"count = {count}: from 0 to {total}")
    if total == 0:
        return 0.0, 1.0
    failures = total - count
    mixed = float(betaln(count + 0.5, failures + 0.5) - betaln(0.5, 0.5))
    limit = mixed + math.log(1.0 - level)

    def above(p: float) -> float:
        likelihood = count * math.log(p) if count else 0.0
        return likelihood + (failures * math.log1p(-p) if failures else 0.0) - limit

    middle, edge = count / total, 1e-15
    low = high = middle
    if count == 0 or above(edge) > 0.0:
        low = 0.0
    else:
        low = float(brentq(above, edge, min(middle, 1.0 - edge), xtol=1e-12))
    if failures == 0 or above(1.0 - edge) > 0.0:
        high = 1.0
    else:
        high = float(brentq(above, max(middle, edge), 1.0 - edge, xtol=1e-12))
    return low, high
