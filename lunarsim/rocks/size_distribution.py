"""Size-frequency distribution of rocks by Golombek and Rapp (1997).

The fraction of terrain covered by rocks of diameter D or more is ``F(D) = k exp(-q D)`` with
``q = 1.79 + 0.152 / k`` (Eq. 13 of the shadow EKF paper), where k is the fraction covered by rocks
of all sizes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import exp1

from lunarsim.errors import InputError
from lunarsim.typing import Array


def golombek_exponent(k: float) -> float:
    """Return the exponent q, 1/m, of the rock cover F(D) = k exp(-q D).

    `k` is the fraction of terrain covered by rocks of all sizes.

    Examples
    --------
    >>> round(golombek_exponent(0.05), 3)
    4.83
    """
    if not 0.0 < k <= 0.5:
        raise InputError("rocks.cover", k, "must be above 0 and at most 0.5")
    return 1.79 + 0.152 / k


def golombek_cover(diameter: ArrayLike, k: float) -> Array:
    """Return F(D), the fraction of terrain covered by rocks of `diameter` (m) or more.

    `k` is the fraction covered by rocks of all sizes.

    Examples
    --------
    >>> np.round(golombek_cover([0.0, 0.5, 1.0], 0.05), 4)
    array([0.05  , 0.0045, 0.0004])
    """
    return np.asarray(k * np.exp(-golombek_exponent(k) * np.asarray(diameter, dtype=np.float64)))


def golombek_number(diameter: ArrayLike, k: float) -> Array:
    """Return N(D), the number of rocks of `diameter` (m) or more per square metre.

    `k` is the fraction of terrain covered by rocks of all sizes.
    From dN = -dF / (pi D^2 / 4): ``N = 4 k q^2 / pi * (exp(-x) / x - E1(x))`` with x = q D.

    Examples
    --------
    >>> np.round(golombek_number([0.2, 1.0], 0.05), 4)
    array([0.2401, 0.0004])
    """
    q = golombek_exponent(k)
    x = q * np.asarray(diameter, dtype=np.float64)
    return np.asarray(4.0 * k * q * q / np.pi * (np.exp(-x) / x - exp1(x)))


def sample_diameters(
    area: float,
    k: float,
    minimum: float,
    maximum: float,
    rng: np.random.Generator,
) -> Array:
    """Sample the diameters (m) of the rocks on `area` (m^2), largest first.

    `k` is the fraction of terrain covered by rocks of all sizes. The number of rocks is Poisson
    distributed with the mean number of diameters from `minimum` to `maximum` (m); diameters are
    sampled by inverting N(D).

    Examples
    --------
    >>> sizes = sample_diameters(1e4, 0.05, 0.3, 2.0, np.random.default_rng(1))
    >>> len(sizes) > 500, bool(sizes.min() >= 0.3)
    (True, True)
    """
    if not 0.0 < minimum < maximum:
        raise InputError(
            "rocks.min_diameter_m",
            minimum,
            f"must be positive and less than max_diameter_m, which is {maximum:g} m",
        )
    # Linear interpolation in (log D, log N) of this table has an error below 1e-6.
    table = np.geomspace(minimum, maximum, 4096)
    number = golombek_number(table, k)
    count = int(rng.poisson(area * (number[0] - number[-1])))
    target = number[-1] + rng.random(count) * (number[0] - number[-1])
    log_d = np.interp(-np.log(target), -np.log(number), np.log(table))
    return np.sort(np.exp(log_d))[::-1].copy()
