"""Stochastic safety through the real support planes: the stochastic form of `bounded_safety`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety.bounded import BLOCK_SIDE, bound_planes
from lunarsim.safety.conservative import StochasticSafety
from lunarsim.safety.exact import (
    check_raster,
    check_variance,
    footprint_maximum,
    highest,
    known_ground,
)
from lunarsim.safety.footprint import Footprint, footprint_of

FloatMap = NDArray[np.float32]


def _pad_heights(high: FloatMap, low: FloatMap, footprint: Footprint) -> tuple[FloatMap, FloatMap]:
    """Return mean and standard deviation of the highest ground under a pad (Eqs. 15 and 16)."""
    top = footprint_maximum(high, footprint.pad_windows, footprint)
    bottom = footprint_maximum(low, footprint.pad_windows, footprint)
    return np.float32(0.5) * (top + bottom), (top - bottom) / np.float32(6.0)


def plane_stochastic_safety(
    mean: ArrayLike,
    variance: ArrayLike,
    grid: Grid,
    lander: Lander,
    *,
    block_side: float = BLOCK_SIDE,
) -> StochasticSafety:
    """Evaluate the safety of a Gaussian DEM with legs and obstacles as Gaussians.

    Legs stand on the highest ground under their pads and obstacles are the highest ground in
    blocks of cells, both Gaussians by the 3-sigma rule of Eqs. 15 and 16. The nominal slope and
    roughness are those of `bounded_safety` on the means. Their spread is the least favourable
    leg's, ``sqrt(2) sigma_leg / h0`` for the slope's tangent, and the leg's and the obstacle's
    together for the roughness; the obstacle's is found by raising all obstacles by 3 sigma.

    Parameters
    ----------
    mean, variance
        Elevation (rows, cols), m and m^2; NaN for unknown.
    grid, lander
        As in `exact_safety`.
    block_side
        As in `bounded_safety`.

    Raises
    ------
    ValueError
        As `bounded_safety`, and if a variance is negative.
    """
    footprint = footprint_of(lander, grid.posting)
    z = check_raster("mean", mean, grid, footprint)
    spread = check_variance(variance, grid, footprint)
    z, observed = known_ground(np.where(np.isfinite(spread), z, np.float32(np.nan)), footprint)
    band = 3.0 * np.sqrt(np.nan_to_num(spread, nan=0.0))
    high, low = (z + band).astype(np.float32), (z - band).astype(np.float32)
    feet, leg_sigma = _pad_heights(high, low, footprint)
    block = footprint.block_cells(block_side, grid.posting)
    tops, bottoms = highest(high, block), highest(low, block)
    middle = np.float32(0.5) * (tops + bottoms)
    tangent, nominal = bound_planes(middle, feet, footprint, block, grid.posting)
    _, raised = bound_planes(tops, feet, footprint, block, grid.posting)
    worst_leg = footprint_maximum(leg_sigma, footprint.leg_windows, footprint)
    obstacle = (raised - nominal) / np.float32(3.0)
    slope_sigma = np.float32(np.sqrt(2.0) / footprint.least_height) * worst_leg
    rough_sigma = np.hypot(obstacle, worst_leg)
    p_slope = _below(np.float32(np.tan(lander.slope_limit)) - tangent, slope_sigma)
    p_rough = _below(np.float32(lander.roughness_limit) - nominal, rough_sigma)
    p_slope[~observed] = 0.0
    p_rough[~observed] = 0.0
    return StochasticSafety(grid, p_slope, p_rough, p_slope * p_rough, observed)


def _below(margin: FloatMap, sigma: FloatMap) -> FloatMap:
    """Return P(x < margin) for x ~ N(0, sigma^2); a step where sigma is 0."""
    certain = sigma <= 0.0
    p = ndtr(margin / np.where(certain, np.float32(1.0), sigma))
    return np.where(certain, (margin > 0.0).astype(np.float32), p).astype(np.float32)
