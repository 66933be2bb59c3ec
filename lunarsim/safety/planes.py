"""Stochastic safety by the real support planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import _plane_kernels as pk
from lunarsim.safety.bounded import BLOCK_SIDE
from lunarsim.safety.conservative import StochasticSafety, stochastic_safety
from lunarsim.safety.footprint import footprint_of
from lunarsim.safety.raster import prepare_elevation, prepare_variance

FloatMap = NDArray[np.float32]


def plane_stochastic_safety(
    mean: ArrayLike,
    variance: ArrayLike,
    grid: Grid,
    lander: Lander,
    *,
    block_side: float = BLOCK_SIDE,
) -> StochasticSafety:
    """Evaluate the probability of safety on a Gaussian DEM by the legs' planes.

    Legs stand on the highest terrain under their pads, and obstacles are the highest terrain in
    blocks of cells; both are Gaussians by the 3-sigma rule of Eqs. 15 and 16 of the Gaussian DEM
    paper. The nominal slope and roughness are those of `bounded_safety` for the means, by the real
    planes only. The standard deviation of the slope's tangent is for the worst leg, ``sqrt(2)
    sigma_leg / h0``. The standard deviation of the roughness combines leg and obstacle; the
    obstacle's standard deviation is found by raising all obstacles by 3 sigma. Obstacle heights are
    vertical, not along the plane's normal: they are at least as large, and neither they nor their
    standard deviation shrink with the slope of the terrain.

    The horizontal plane of Eqs. 15 to 17 also gives a conservative probability for the slope and
    one for the roughness (`stochastic_safety`). For each of the two limits, the higher of both
    probabilities is used.

    Parameters
    ----------
    mean, variance, grid, lander
        Mean (m) and variance (m^2) of the elevation (rows, cols), NaN where unknown; grid of the
        elevation; lander with its limits.
    block_side
        Side of the blocks, m, rounded to complete cells.

    Raises
    ------
    InputError
        If a raster is invalid for the grid, the grid is smaller than the footprint, a variance is
        negative, or `block_side` is not positive.
    """
    footprint = footprint_of(lander, grid.posting)
    block = footprint.block_cells(block_side, grid.posting)
    height = prepare_elevation("mean", mean, grid, footprint)
    level = stochastic_safety(mean, variance, grid, lander)
    tangent, nominal, raised, leg = (np.empty(grid.shape, np.float32) for _ in range(4))
    pk.stochastic_planes(
        height.z_float64,
        height.middle,
        prepare_variance(variance, grid, footprint),
        footprint.cells,
        footprint.covers(block),
        block,
        np.float32(grid.posting),
        tangent,
        nominal,
        raised,
        leg,
    )
    slope_sigma = np.float32(np.sqrt(2.0) / footprint.min_triangle_height) * leg
    rough_sigma = np.hypot((raised - nominal) / np.float32(3.0), leg)
    p_slope = _probability_below(np.float32(np.tan(lander.slope_limit)) - tangent, slope_sigma)
    p_rough = _probability_below(np.float32(lander.roughness_limit) - nominal, rough_sigma)
    p_slope = np.where(level.observed, np.maximum(p_slope, level.p_slope), np.float32(0.0))
    p_rough = np.where(level.observed, np.maximum(p_rough, level.p_roughness), np.float32(0.0))
    return StochasticSafety(grid, p_slope, p_rough, p_slope * p_rough, level.observed)


def _probability_below(margin: FloatMap, sigma: FloatMap) -> FloatMap:
    """Return P(x < margin) for x ~ N(0, sigma^2); a step function where sigma is 0."""
    certain = sigma <= 0.0
    p = ndtr(margin / np.where(certain, np.float32(1.0), sigma))
    return np.where(certain, (margin > 0.0).astype(np.float32), p).astype(np.float32)
