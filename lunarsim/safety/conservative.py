"""The conservative test by height differences, and its stochastic form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import _kernels as k
from lunarsim.safety.exact import SafetyMap, height_differences
from lunarsim.safety.footprint import Footprint, footprint_of
from lunarsim.safety.raster import prepare_elevation, prepare_variance
from lunarsim.typing import BoolArray

FloatMap = NDArray[np.float32]
BoolMap = BoolArray


@dataclass(frozen=True)
class StochasticSafety:
    """Probabilities that a lander centred on each cell is safe.

    Attributes
    ----------
    grid
        Grid of the cells.
    p_slope, p_roughness
        Probabilities that slope and roughness are below their limits (rows, cols); 0 where not
        observed.
    p_safe
        Product of `p_slope` and `p_roughness` (rows, cols), the probability of safe terrain.
    observed
        False where the footprint leaves the map or contains unknown terrain (rows, cols).
    """

    grid: Grid
    p_slope: FloatMap
    p_roughness: FloatMap
    p_safe: FloatMap
    observed: BoolMap


def conservative_safety(elevation: ArrayLike, grid: Grid, lander: Lander) -> SafetyMap:
    """Evaluate upper bounds of slope and roughness by height differences.

    These are Eqs. 10 and 11 of the Gaussian DEM paper: ``sin(slope) = (max_L z - min_L z) / h0``
    and ``roughness = max_U z - min_L z``. L is the set of cells that any pad may touch, U the set
    of cells under the lander, h0 the minimum height of a triangle of legs. A cell classified as
    safe is safe by `exact_safety` (Proposition III.1), which has the same parameters and errors.

    Examples
    --------
    >>> grid = Grid.centred((0.0, 0.0), 12.0, 0.2)
    >>> found = conservative_safety(np.zeros(grid.shape), grid, Lander())
    >>> bool(found.safe[30, 30]), bool(found.observed[0, 0])  # its footprint leaves the map
    (True, False)
    """
    footprint = footprint_of(lander, grid.posting)
    span, roughness = height_differences(
        prepare_elevation("elevation", elevation, grid, footprint), footprint
    )
    observed = roughness < k.FAR
    slope = level_slope(span, footprint)
    slope[~observed] = np.nan
    roughness[~observed] = np.nan
    safe = (slope < lander.slope_limit) & (roughness < lander.roughness_limit)
    return SafetyMap(grid, slope, roughness, safe, observed)


def level_slope(span: FloatMap, footprint: Footprint) -> FloatMap:
    """Return the upper bound of slope from height differences under the pads, rad.

    `span` (rows, cols) is the maximum minus the minimum height over all cells that a pad may touch,
    m. The bound (rows, cols) is Eq. 11 of the Gaussian DEM paper; it is pi/2 where `span` reaches
    the minimum height of a triangle of legs.
    """
    sine = span / np.float32(footprint.min_triangle_height)
    # The theorem requires a height difference below h0; steeper terrain is unsafe.
    slope = np.where(sine < 1.0, np.arcsin(np.clip(sine, 0.0, 1.0)), np.float32(np.pi / 2))
    return slope.astype(np.float32)


def stochastic_safety(
    mean: ArrayLike,
    variance: ArrayLike,
    grid: Grid,
    lander: Lander,
    *,
    slope_bound: Literal["sin", "tan"] = "sin",
) -> StochasticSafety:
    """Evaluate the probability of safety on a Gaussian DEM by a horizontal plane.

    This is the stochastic form of the conservative test (Eqs. 15 to 17 of the Gaussian DEM paper).

    Maxima and minima of the heights are approximated by Gaussians fitted to the extremes of the
    3-sigma bounds; slope and roughness follow from differences of two such Gaussians.

    Parameters
    ----------
    mean, variance
        Mean (m) and variance (m^2) of the elevation (rows, cols). Terrain is unknown where the mean
        is NaN, infinite, masked or implausible (`lunarsim.safety.raster`), and where the
        variance is NaN, infinite or masked.
    grid, lander
        Grid of the elevation, and lander with its limits.
    slope_bound
        ``"sin"``: Eq. 11, which has the guarantee; ``"tan"``: Eq. 17 as printed.

    Raises
    ------
    InputError
        If a raster is invalid for the grid, the grid is smaller than the footprint, a variance is
        negative, or `slope_bound` is invalid.
    """
    if slope_bound not in ("sin", "tan"):
        raise InputError("slope_bound", slope_bound, "must be 'sin' or 'tan'")
    footprint = footprint_of(lander, grid.posting)
    height = prepare_elevation("mean", mean, grid, footprint)
    spread = prepare_variance(variance, grid, footprint)
    p_slope, p_rough, p_safe = (np.empty(grid.shape, np.float32) for _ in range(3))
    observed = np.empty(grid.shape, np.bool_)
    ratio = np.sin(lander.slope_limit) if slope_bound == "sin" else np.tan(lander.slope_limit)
    k.stochastic(
        height.z_float64,
        height.middle,
        spread,
        footprint.cells,
        np.float32(footprint.min_triangle_height * ratio),
        np.float32(lander.roughness_limit),
        p_slope,
        p_rough,
        p_safe,
        observed,
    )
    return StochasticSafety(grid, p_slope, p_rough, p_safe, observed)
