"""From the bounds of Eqs. 15 to 17 to a frequency.

The conservative test answers for the worst of what a footprint may hold, so its probabilities are
bounds and not frequencies: many sites that it calls hopeless are safe. What it says of slope and
roughness still ranks sites; a logistic regression on both, measured on testbeds, turns it into a
probability that comes true as often as it says.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from lunarsim.errors import InputError
from lunarsim.hazards.logistic import Logistic
from lunarsim.hazards.safety.conservative import StochasticSafety

Array = NDArray[np.float64]

# Probits beyond these are alike.
_LIMIT = 6.0
_KNOTS = (-3.0, -1.0, 1.0, 3.0)
COUNT = 36


def features(p_slope: ArrayLike, p_roughness: ArrayLike, spacing: float) -> Array:
    """Return what the calibrated probability is computed from (n, `COUNT`).

    Parameters
    ----------
    p_slope, p_roughness
        Of Eqs. 15 and 17 (n,).
    spacing
        Ground sample distance of the scan, m.
    """
    tiny = 1e-30
    columns = [np.ones(np.size(p_slope))]
    lines = []
    for bound in (p_slope, p_roughness):
        p = np.asarray(bound, dtype=np.float64).ravel()
        z = np.clip(ndtri(np.clip(p, tiny, 1.0 - 1e-12)), -_LIMIT, _LIMIT)
        lines.append(z)
        columns += [z, *(np.maximum(z - knot, 0.0) for knot in _KNOTS)]
    columns.append(lines[0] * lines[1])
    base = np.column_stack(columns)
    g = np.log(spacing / 0.3)
    return np.hstack((base, g * base, g * g * base))


@lru_cache(maxsize=1)
def measured() -> Logistic:
    """Return the regression measured by `scenarios/gaussian_dem_calibration.py`."""
    return Logistic.packaged("lunarsim.hazards.safety", "calibration.json", COUNT)


def calibrated_safety(
    safety: StochasticSafety, spacing: float, model: Logistic | None = None
) -> NDArray[np.float32]:
    """Return the probability that a site is safe, as a frequency (rows, cols); 0 if not observed.

    Parameters
    ----------
    safety
        Of `stochastic_safety`.
    spacing
        Ground sample distance of the scan, m: within 0.15 to 1.3 m, where it was measured.
    model
        Left out: the packaged one, for the lander of the testbeds (2.35 m legs, 10 deg, 0.25 m).

    Raises
    ------
    InputError
        If the spacing is out of that range.
    """
    if not 0.1 <= spacing <= 2.0:
        raise InputError("calibration.spacing", spacing, "a ground sample distance of 0.1 to 2 m")
    model = model or measured()
    p = np.zeros(safety.p_safe.shape, np.float32)
    seen = safety.observed
    p[seen] = model.probability(features(safety.p_slope[seen], safety.p_roughness[seen], spacing))
    return p
