"""ALHAT baseline: deterministic slope, and roughness with independent noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety.conservative import StochasticSafety
from lunarsim.safety.exact import exact_safety


def alhat_safety(
    elevation: ArrayLike, grid: Grid, lander: Lander, *, sigma: float
) -> StochasticSafety:
    """Evaluate landing safety by the ALHAT baseline of the Gaussian DEM paper.

    This is section III.B of the paper.

    Slope safety is deterministic. Roughness safety is evaluated at every cell of the footprint at
    every heading, for elevation noise of standard deviation `sigma` that is independent between
    cells. The minimum of these probabilities is used, since their product would be near zero for
    footprints of many cells. It is the probability at the worst roughness, because the normal
    distribution function is monotonic.

    Parameters
    ----------
    elevation, grid, lander
        Elevation (rows, cols), m, with NaN where unknown; grid of the elevation; lander with its
        limits.
    sigma
        Standard deviation of the elevations, m.

    Raises
    ------
    InputError
        If the elevation is invalid for the grid, the grid is smaller than the footprint, or `sigma`
        is not positive.
    """
    if not (np.isfinite(sigma) and sigma > 0.0):
        raise InputError("sigma", sigma, "must be positive and finite")
    exact = exact_safety(elevation, grid, lander)
    with np.errstate(invalid="ignore"):
        p_slope = (exact.slope < lander.slope_limit).astype(np.float32)
        p_rough = ndtr((lander.roughness_limit - exact.roughness) / sigma).astype(np.float32)
    p_slope[~exact.observed] = 0.0
    p_rough[~exact.observed] = 0.0
    return StochasticSafety(grid, p_slope, p_rough, p_slope * p_rough, exact.observed)
