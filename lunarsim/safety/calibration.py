"""From the bounds of Eqs. 15 to 17 to a frequency.

The conservative test answers for the worst of what a footprint may hold, so its probabilities are
bounds and not frequencies: many sites that it calls hopeless are safe, and ground that a rock hides
from an oblique scan counts as the worst. What the support planes say of the mean elevations knows
nothing of what was not seen. A logistic regression on both, measured on testbeds, gives a
probability that comes true as often as it says.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.special import expit, ndtri

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.safety.conservative import StochasticSafety
from lunarsim.safety.exact import SafetyMap
from lunarsim.safety.logistic import Logistic

Array = NDArray[np.float64]

# Probits between which the regression may bend.
_KNOTS = np.array([-6.0, -3.0, -1.0, 1.0, 3.0, 6.0])
# Shares of the limits between which it may bend.
_SHARES = np.array([0.0, 0.4, 0.7, 0.9, 1.0, 1.1, 1.3, 1.6, 2.5])
COUNT = 1 + 2 * (len(_KNOTS) - 1) + 2 * (len(_SHARES) - 1)
# Scans by which it was measured: ground sample distance across the line of sight, m, and how many
# times longer it is along it. (200, 500 and 1000 m; 0, 30 and 60 deg.)
ACROSS = (0.15625, 0.390625, 0.78125)
ALONG = (1.0, 1.1585, 2.0619)


def features(
    p_slope: ArrayLike, p_roughness: ArrayLike, slope: ArrayLike, roughness: ArrayLike
) -> Array:
    """Return what the calibrated probability is computed from (n, `COUNT`).

    A one, how much of each interval between probits the two bounds have passed, and how much of
    each interval between shares of the limits the mean's slope and roughness leave: with weights
    that are not negative a better bound, a gentler slope or smoother ground never lowers the
    probability.

    Parameters
    ----------
    p_slope, p_roughness
        Of Eqs. 15 and 17 (n,).
    slope, roughness
        Of `bounded_safety` on the means, as shares of the lander's limits (n,).
    """
    columns = [np.ones(np.size(p_slope))]
    for bound in (p_slope, p_roughness):
        p = np.asarray(bound, dtype=np.float64).ravel()
        z = ndtri(np.clip(p, 1e-30, 1.0 - 1e-12))
        columns += [np.clip((z - low) / (high - low), 0.0, 1.0) for low, high in pairwise(_KNOTS)]
    for share in (slope, roughness):
        used = np.asarray(share, dtype=np.float64).ravel()
        columns += [
            np.clip((high - used) / (high - low), 0.0, 1.0) for low, high in pairwise(_SHARES)
        ]
    return np.column_stack(columns)


@lru_cache(maxsize=1)
def measured() -> Logistic:
    """Return the weights measured by `scenarios/gaussian_dem/calibration.py`.

    One set a scan: (across, along, feature), flat.
    """
    count = len(ACROSS) * len(ALONG) * COUNT
    return Logistic.packaged("lunarsim.safety", "calibration.json", count)


def calibrated_safety(
    safety: StochasticSafety,
    nominal: SafetyMap,
    lander: Lander,
    spacing: tuple[float, float],
    model: Logistic | None = None,
) -> NDArray[np.float32]:
    """Return the probability that a site is safe, as a frequency (rows, cols); 0 if not observed.

    Parameters
    ----------
    safety
        Of `stochastic_safety`.
    nominal
        Of `bounded_safety` on the mean elevations.
    lander
        Of both.
    spacing
        Ground sample distances of the scan along the line of sight and across it, m. Between the
        scans that were measured weights are interpolated, beyond them the nearest counts.
    model
        Left out: the packaged one, for the lander of the testbeds (2.35 m legs, 10 deg, 0.25 m).

    Raises
    ------
    InputError
        If a spacing is no distance from 0.1 to 2 m, or the two maps lie on different grids.
    """
    if safety.grid != nominal.grid:
        raise InputError("calibration.nominal", nominal.grid, f"a map on {safety.grid}")
    if not all(0.1 <= s <= 2.0 for s in spacing):
        raise InputError("calibration.spacing", spacing, "ground sample distances of 0.1 to 2 m")
    along, across = spacing
    weights = np.array((model or measured()).weights).reshape(len(ACROSS), len(ALONG), COUNT)
    place = (
        np.log(np.clip(across, ACROSS[0], ACROSS[-1])),
        np.log(np.clip(along / across, ALONG[0], ALONG[-1])),
    )
    own = RegularGridInterpolator((np.log(ACROSS), np.log(ALONG)), weights)(place).reshape(COUNT)
    p = np.zeros(safety.p_safe.shape, np.float32)
    seen = safety.observed & nominal.observed
    p[seen] = expit(
        features(
            safety.p_slope[seen],
            safety.p_roughness[seen],
            nominal.slope[seen] / lander.slope_limit,
            nominal.roughness[seen] / lander.roughness_limit,
        )
        @ own
    )
    return p
