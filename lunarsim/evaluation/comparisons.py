"""Compare arms that flew the same flights.

Arms meet the same worlds and noise, so flights are paired. Tests of several differences are
corrected by Holm's step-down procedure (Holm 1979, Scand. J. Statist. 6, 65).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri
from scipy.stats import beta, binom, binomtest, bootstrap, norm, ttest_1samp

from lunarsim.typing import Array

# Bootstrap resamples; the cost grows with resamples times values.
_RESAMPLES = 2000
# Above this number of values the normal interval is as good as a bootstrap.
_MAX_BOOTSTRAP_VALUES = 20_000


@dataclass(frozen=True)
class Difference:
    """Difference of a metric between two variants that flew the same flights.

    The difference is the second variant minus the first.

    Attributes
    ----------
    first, second
        Names of the variants (arms) of the campaign.
    pairs
        Number of flights that both variants have.
    value, low, high
        Mean difference and its 95 % interval.
    p
        Two-sided p-value of no difference.
    corrected
        p-value after Holm's correction for all differences that are tested together.
    """

    first: str
    second: str
    pairs: int
    value: float
    low: float
    high: float
    p: float
    corrected: float = float("nan")


def share_difference(
    first: ArrayLike, second: ArrayLike, names: tuple[str, str], level: float = 0.95
) -> Difference:
    """Compare the success rates of two variants on the same flights.

    The interval is Newcombe's interval for paired proportions (Newcombe 1998, Statist. Med. 17,
    2635, method 10); the test is McNemar's exact test. Without flights the difference is NaN.

    Parameters
    ----------
    first, second
        Success of each flight under the first and the second variant (n,), boolean.
    names
        Names of the variants.
    level
        Confidence level of the interval.
    """
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    n = len(a)
    if n == 0:
        return Difference(*names, 0, float("nan"), -1.0, 1.0, 1.0)
    gained, lost = int((b & ~a).sum()), int((a & ~b).sum())
    low, high = _newcombe(int((a & b).sum()), gained, lost, int((~a & ~b).sum()), level)
    p = binomtest(gained, gained + lost).pvalue if gained + lost else 1.0
    return Difference(*names, n, (gained - lost) / n, low, high, float(p))


def _newcombe(both: int, gained: int, lost: int, neither: int, level: float) -> tuple[float, float]:
    """Return Newcombe's interval of the second success rate minus the first.

    Arguments are the numbers of flights that succeed under both variants, under the second only,
    under the first only, and under neither; `level` is the confidence level.
    """
    n = both + gained + lost + neither
    p1, p2 = (both + lost) / n, (both + gained) / n
    l1, u1 = (float(v) for v in binomtest(both + lost, n).proportion_ci(level, "wilson"))
    l2, u2 = (float(v) for v in binomtest(both + gained, n).proportion_ci(level, "wilson"))
    product = (both + lost) * (gained + neither) * (both + gained) * (lost + neither)
    phi = 0.0
    if product > 0:
        top = both * neither - gained * lost
        phi = (max(top - n / 2.0, 0.0) if top > 0 else float(top)) / float(np.sqrt(float(product)))
    down = (p2 - l2) ** 2 - 2.0 * phi * (p2 - l2) * (u1 - p1) + (u1 - p1) ** 2
    up = (u2 - p2) ** 2 - 2.0 * phi * (u2 - p2) * (p1 - l1) + (p1 - l1) ** 2
    value = p2 - p1
    return value - max(down, 0.0) ** 0.5, value + max(up, 0.0) ** 0.5


def mean_difference(
    first: ArrayLike, second: ArrayLike, names: tuple[str, str], rng: np.random.Generator
) -> Difference:
    """Compare the mean of a metric of two variants on the same flights, ignoring NaN.

    `first` and `second` (n,) are its values by flight, `names` the variants. The interval is a
    bias-corrected bootstrap over flights; the test is Student's paired t-test. With fewer than two
    pairs, or if all differences are equal, there is no test: p is 1 for a difference of 0 and
    otherwise NaN.
    """
    d = np.asarray(second, dtype=np.float64) - np.asarray(first, dtype=np.float64)
    d = d[np.isfinite(d)]
    if len(d) < 2 or np.ptp(d) == 0.0:
        value = float(d.mean()) if len(d) else float("nan")
        edge = value if len(d) > 1 else float("nan")
        return Difference(*names, len(d), value, edge, edge, 1.0 if value == 0.0 else float("nan"))
    low, high = bootstrap_interval(d, rng)
    return Difference(*names, len(d), float(d.mean()), low, high, float(ttest_1samp(d, 0.0).pvalue))


def bootstrap_interval(
    values: ArrayLike, rng: np.random.Generator, level: float = 0.95
) -> tuple[float, float]:
    """Return the BCa bootstrap confidence interval of a mean.

    NaN values are ignored; the result is NaN for fewer than 2 values. Above 20,000 values the
    normal interval is used, which is then practically equal.
    """
    x = np.asarray(values, dtype=np.float64)
    x = x[np.isfinite(x)]
    if len(x) < 2:
        return float("nan"), float("nan")
    if np.ptp(x) == 0.0:
        return float(x[0]), float(x[0])
    if len(x) > _MAX_BOOTSTRAP_VALUES:
        half = float(norm.ppf(0.5 + 0.5 * level) * x.std(ddof=1) / np.sqrt(len(x)))
        return float(x.mean()) - half, float(x.mean()) + half
    found = bootstrap(
        (x,), np.mean, n_resamples=_RESAMPLES, confidence_level=level, batch=200, rng=rng
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def holm_correction(p: Sequence[float]) -> Array:
    """Correct p-values (n,) for multiple tests by Holm's method.

    NaN stays NaN and does not count as a test. The order is kept.
    """
    values = np.asarray(p, dtype=np.float64)
    out = np.full(len(values), np.nan)
    known = np.flatnonzero(np.isfinite(values))
    order = known[np.argsort(values[known], kind="stable")]
    worst = 0.0
    for rank, index in enumerate(order):
        worst = max(worst, min(1.0, (len(order) - rank) * values[index]))
        out[index] = worst
    return out


def quantile_interval(
    values: ArrayLike, q: float, level: float = 0.95
) -> tuple[float, float, float]:
    """Return the quantile `q` of values (n,), and its distribution-free interval.

    The result is quantile, low end and high end. The interval, at the confidence `level`, is
    between order statistics; its ends are NaN if there are too few values. NaN values are ignored.
    """
    x = np.sort(np.asarray(values, dtype=np.float64))
    x = x[np.isfinite(x)]
    n = len(x)
    if n == 0:
        return float("nan"), float("nan"), float("nan")
    tail = 0.5 * (1.0 - level)
    lower, upper = int(binom.ppf(tail, n, q)), int(binom.ppf(1.0 - tail, n, q)) + 1
    low = float(x[lower - 1]) if lower >= 1 else float("nan")
    high = float(x[upper - 1]) if upper <= n else float("nan")
    return float(np.quantile(x, q)), low, high


@dataclass(frozen=True)
class Ellipse:
    """Confidence ellipse of landing points, assuming a normal distribution.

    Attributes
    ----------
    centre
        East and north (2,), m.
    half_axes
        Semi-major and semi-minor axis (2,), m.
    azimuth
        Azimuth of the major axis, from north towards east, rad.
    level
        Fraction of landings that the ellipse should contain.
    inside
        Fraction of landings inside; a large difference from `level` shows a non-normal
        distribution.
    """

    centre: Array
    half_axes: Array
    azimuth: float
    level: float
    inside: float


def landing_ellipse(xy: ArrayLike, level: float = 0.95) -> Ellipse | None:
    """Return the confidence ellipse of landing points (n, 2), m; None if fewer than 3.

    NaN values are ignored.
    """
    points = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 3:
        return None
    centre, covariance = points.mean(axis=0), np.cov(points.T)
    values, vectors = np.linalg.eigh(covariance)
    bound = float(chdtri(2, 1.0 - level))
    # Rounding can make a zero variance negative.
    values = np.maximum(values, 0.0)
    off = (points - centre) @ vectors
    scaled = (off**2 / np.where(values > 0.0, values, np.inf)).sum(axis=1)
    east, north = vectors[:, 1]
    return Ellipse(
        centre, np.sqrt(bound * values[::-1]), float(np.arctan2(east, north) % np.pi), level,
        float((scaled <= bound).mean()),
    )  # fmt: skip


def share_upper_bound(count: int, total: int, level: float = 0.95) -> float:
    """Return the Clopper-Pearson upper bound of a proportion: about 3 / n for 0 of n.

    `count` of `total` trials succeed; `level` is the one-sided confidence level.
    """
    return 1.0 if count >= total else float(beta.ppf(level, count + 1, total - count))
