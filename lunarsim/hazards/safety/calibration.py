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
COUNT = 60


def features(p_slope: ArrayLike, p_roughness: ArrayLike, spacing: tuple[float, float]) -> Array:
    """Return what the calibrated probability is computed from (n, `COUNT`).

    Parameters
    ----------
    p_slope, p_roughness
        Of Eqs. 15 and 17 (n,).
    spacing
        Ground sample distances of the scan along the line of sight and across it, m.
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
    g = 0.5 * np.log(spacing[0] * spacing[1] / 0.09)
    slant = np.log(spacing[0] / spacing[1])
    return np.hstack([factor * base for factor in (1.0, g, g * g, slant, slant * g)])


@lru_cache(maxsize=1)
def measured() -> Logistic:
    """Return the regression measured by `scenarios/gaussian_dem_calibration.py`."""
    return Logistic.packaged("lunarsim.hazards.safety", "calibration.json", COUNT)


def calibrated_safety(
    safety: StochasticSafety, spacing: tuple[float, float], model: Logistic | None = None
) -> NDArray[np.float32]:
    """Return the probability that a site is safe, as a frequency (rows, cols); 0 if not observed.

    Parameters
    ----------
    safety
        Of `stochastic_safety`.
    spacing
        Ground sample distances of the scan along the line of sight and across it, m; measured from
        0.156 to 1.61 m.
    model
        Left out: the packaged one, for the lander of the testbeds (2.35 m legs, 10 deg, 0.25 m).

    Raises
    ------
    InputError
        If a spacing is far out of that range.
    """
    if not all(0.1 <= s <= 2.0 for s in spacing):
        raise InputError("calibration.spacing", spacing, "ground sample distances of 0.1 to 2 m")
    model = model or measured()
    p = np.zeros(safety.p_safe.shape, np.float32)
    seen = safety.observed
    p[seen] = model.probability(features(safety.p_slope[seen], safety.p_roughness[seen], spacing))
    return p
