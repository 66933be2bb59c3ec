"""Exact landing safety over all headings and all admissible support planes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import _exact_kernels as ek
from lunarsim.safety import _kernels as k
from lunarsim.safety.footprint import BLOCK, Footprint, footprint_of
from lunarsim.safety.raster import ElevationRaster, prepare_elevation
from lunarsim.typing import BoolArray

FloatMap = NDArray[np.float32]
BoolMap = BoolArray


@dataclass(frozen=True)
class SafetyMap:
    """Slope, roughness and landing safety of a lander centred on each cell.

    Attributes
    ----------
    grid
        Grid of the cells.
    slope
        Maximum slope over headings and support planes (rows, cols), rad; NaN where not observed.
    roughness
        Maximum roughness over headings and support planes (rows, cols), m; NaN where not observed.
    safe
        Whether slope and roughness are below the lander's limits (rows, cols); False where not
        observed.
    observed
        False where the footprint leaves the map or contains unknown terrain (rows, cols).
    """

    grid: Grid
    slope: FloatMap
    roughness: FloatMap
    safe: BoolMap
    observed: BoolMap


def exact_safety(
    elevation: ArrayLike, grid: Grid, lander: Lander, *, heading: float | None = None
) -> SafetyMap:
    """Evaluate the exact slope, roughness and safety of landing on each cell.

    This is Definition III.1 of the Gaussian DEM paper on a grid.

    At each heading (azimuth of the body x axis) the pads rest on the highest terrain under them;
    slope (Eq. 8) and roughness (Eq. 9, over the polygon of the legs) are the worst over the
    admissible support planes (`lunarsim.core.touchdown.support_planes`). Legs keep their
    horizontal position (Eq. 19).

    Parameters
    ----------
    elevation
        Elevation (rows, cols), m. NaN, infinities, masked cells and implausible heights are
        unknown, by the rule of `lunarsim.safety.raster`.
    grid
        Grid of the elevation.
    lander
        Geometry and limits of the lander.
    heading
        Azimuth of body x (rad) to evaluate only one heading, the nearest that differs on the grid;
        omitted: all headings.

    Raises
    ------
    InputError
        If the elevation is not an array of real numbers or does not have the grid's shape, the grid
        is smaller than the footprint, or the heading is not finite.

    Examples
    --------
    >>> grid = Grid.centred((0.0, 0.0), 12.0, 0.2)
    >>> terrain = np.zeros(grid.shape)
    >>> terrain[30, 30] = 0.6  # a rock in the middle
    >>> found = exact_safety(terrain, grid, Lander())
    >>> bool(found.safe[30, 30]), round(float(found.roughness[30, 30]), 2)
    (False, 0.6)
    """
    footprint = _footprint(lander, grid.posting, heading)
    height = prepare_elevation("elevation", elevation, grid, footprint)
    everywhere = np.ones(grid.shape, np.bool_)
    tangent, roughness = _evaluate(height, everywhere, footprint, lander, grid.posting, False)
    observed = ~np.isnan(tangent)
    slope = np.arctan(tangent)
    safe = (slope < lander.slope_limit) & (roughness < lander.roughness_limit)
    return SafetyMap(grid, slope, roughness, safe, observed)


def safe_sites(
    elevation: ArrayLike,
    grid: Grid,
    lander: Lander,
    *,
    heading: float | None = None,
    where: BoolMap | None = None,
    stride: int = 1,
) -> tuple[BoolMap, BoolMap]:
    """Return which cells are safe landing sites by the exact safety test.

    This is faster than `exact_safety`, which has the same parameters and errors and also returns
    the slope and roughness of each cell. Without a stride, sites that pass the conservative test
    need no more work; the evaluation of the other sites stops as soon as a limit is exceeded.

    Parameters
    ----------
    elevation, grid, lander, heading
        As for `exact_safety`.
    where
        Sites to evaluate; omitted: all. The others count as not observed.
    stride
        Distance between sites, cells: sites are the cells ``[::stride, ::stride]``, and the results
        and `where` have their shape. Terrain finer than the distance between sites then counts.

    Returns
    -------
    safe, observed
        Whether a lander centred on each site is safe, False where not observed, and whether its
        complete footprint is known terrain.
    """
    footprint = _footprint(lander, grid.posting, heading)
    height = prepare_elevation("elevation", elevation, grid, footprint)
    shape = height.z[::stride, ::stride].shape
    selected = np.ones(shape, np.bool_) if where is None else where
    clearly_safe: BoolMap = np.zeros(shape, np.bool_)
    if stride == 1:
        span, rise = height_differences(height, footprint)
        is_level = span < footprint.min_triangle_height * np.sin(lander.slope_limit)
        clearly_safe = selected & is_level & (rise < lander.roughness_limit)
    todo = selected & ~clearly_safe
    tangent, roughness = _evaluate(height, todo, footprint, lander, grid.posting, True, stride)
    observed = clearly_safe | ~np.isnan(tangent)
    passed = (np.arctan(tangent) < lander.slope_limit) & (roughness < lander.roughness_limit)
    return clearly_safe | passed, observed


def _footprint(lander: Lander, posting: float, heading: float | None) -> Footprint:
    """Return the footprint of a lander at all headings or at one.

    `heading` is the azimuth of body x, rad, `posting` is the grid spacing, m.
    """
    footprint = footprint_of(lander, posting)
    if heading is None:
        return footprint
    if not (
        isinstance(heading, (int, float, np.number))
        and np.isrealobj(heading)
        and np.isfinite(heading)
    ):
        raise InputError("heading", heading, "must be a finite number, an azimuth in rad")
    return footprint.one_heading(footprint.nearest_heading(lander, posting, heading))


def height_differences(height: ElevationRaster, footprint: Footprint) -> tuple[FloatMap, FloatMap]:
    """Return height differences over the footprint of each cell (Eq. 10), m.

    Both results are (rows, cols). The first is the maximum minus the minimum over L, the cells that
    any pad may touch; the second is the maximum over U, the cells under the lander, minus the
    minimum over L. Both are `FAR` where the footprint contains unknown terrain or leaves the map.
    """
    span, rise = np.empty(height.z.shape, np.float32), np.empty(height.z.shape, np.float32)
    k.footprint_extremes(height.z_float64, height.middle, footprint.cells, span, rise)
    return span, rise


def _evaluate(
    height: ElevationRaster,
    selected: BoolMap,
    footprint: Footprint,
    lander: Lander,
    posting: float,
    classify_only: bool,
    stride: int = 1,
) -> tuple[FloatMap, FloatMap]:
    """Return the exact tan(slope) and roughness (m) of the `selected` cells.

    All three arrays are (rows, cols). Both results are NaN in cells that are not selected or whose
    footprint is not known terrain. With `classify_only`, the values are only valid for comparison
    with the limits.
    """
    limit = np.float32(lander.roughness_limit)
    tangent, roughness = (np.full(selected.shape, np.nan, np.float32) for _ in range(2))
    ek.exact(
        height.z_float64,
        height.middle,
        selected,
        footprint.cells,
        footprint.covers(BLOCK),
        stride,
        np.float32(posting),
        np.float32(np.tan(lander.slope_limit)),
        # Reaching the limit is unsafe; the kernel tests for values above its argument.
        np.nextafter(limit, np.float32(0.0)) if classify_only else limit,
        classify_only,
        tangent,
        roughness,
    )
    return tangent, roughness
