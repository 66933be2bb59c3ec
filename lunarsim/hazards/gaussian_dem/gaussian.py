"""The Gaussian DEM: local Gaussian random field regression on a Delaunay triangulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay, QhullError

from lunarsim.grid import Grid
from lunarsim.hazards.gaussian_dem import _kernels as k
from lunarsim.hazards.gaussian_dem.conventional import check_points

FloatMap = NDArray[np.float32]
BoolMap = NDArray[np.bool_]

# A cell whose samples weigh more than this is measured, not interpolated.
_DENSE = 0.5
# A triangle this many times longer than the median one spans an occlusion.
_GAP = 4.0


@dataclass(frozen=True)
class GaussianDem:
    """Mean and variance of the elevation.

    Attributes
    ----------
    grid
        Places the cells; values belong to cell centres.
    mean
        Mean elevation (rows, cols), m; NaN where nothing is known.
    variance
        Variance (rows, cols), m^2; the prior's where nothing is known.
    observed
        False outside the hull of the samples and across occlusions (rows, cols).
    """

    grid: Grid
    mean: FloatMap
    variance: FloatMap
    observed: BoolMap


def gaussian_dem(
    points: ArrayLike,
    grid: Grid,
    *,
    sigma_f: float = 0.5,
    length_scale: float = 30.0,
    sigma_eps: float = 0.01,
) -> GaussianDem:
    """Build a Gaussian DEM from a point cloud (section II of the Gaussian DEM paper).

    Cells with enough samples take the conventional DEM's value and the sensor's variance. The
    others take the regression of Eqs. 5 and 6 with the absolute exponential kernel of Eq. 4
    from the three vertices of the Delaunay triangle that holds their centre. The prior mean is
    the vertices' mean: a zero mean pulls relief towards z = 0.

    Parameters
    ----------
    points
        East, north, up (n, 3), m; rows with NaN are left out.
    grid
        The cells.
    sigma_f
        Prior standard deviation of the terrain, m.
    length_scale
        Length scale of the kernel, m. Only sigma_f^2 / length_scale matters when the length
        scale is much longer than the triangles.
    sigma_eps
        Standard deviation of a sample, m.

    Raises
    ------
    ValueError
        If the array is not (n, 3), holds infinities, or a parameter is not positive.
    """
    for name, value in (("sigma_f", sigma_f), ("length_scale", length_scale)):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} = {value}: must be a positive length in metres")
    if not (np.isfinite(sigma_eps) and sigma_eps >= 0.0):
        raise ValueError(f"sigma_eps = {sigma_eps}: must be 0 or a positive length in metres")
    cloud = check_points(points)
    total, weight = k.splat(cloud, grid.x0, grid.y0, grid.posting, grid.rows, grid.cols)
    dense = weight > _DENSE
    mean = np.full(grid.shape, np.nan)
    mean[dense] = total[dense] / weight[dense]
    variance = np.full(grid.shape, sigma_f**2)
    variance[dense] = sigma_eps**2
    observed = dense.copy()
    if not dense.all():
        _interpolate(cloud, grid, dense, mean, variance, observed, sigma_f, length_scale, sigma_eps)
    return GaussianDem(grid, mean.astype(np.float32), variance.astype(np.float32), observed)


def _interpolate(
    cloud: NDArray[np.float64],
    grid: Grid,
    dense: BoolMap,
    mean: NDArray[np.float64],
    variance: NDArray[np.float64],
    observed: BoolMap,
    sigma_f: float,
    length_scale: float,
    sigma_eps: float,
) -> None:
    """Fill the cells that are not dense, in place, from the triangulation of the samples."""
    cloud = _merge_coincident(cloud)
    if len(cloud) < 3:
        return
    try:
        triangles = Delaunay(cloud[:, :2]).simplices.astype(np.int64)
    except QhullError:
        return  # all samples on one line: no triangle holds a cell
    corners = cloud[triangles, :2]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    use = edges <= _GAP * np.median(edges)
    owner = np.full(grid.shape, -1, np.int64)
    k.own_cells(cloud, triangles, grid.x0, grid.y0, grid.posting, ~dense, owner)
    k.regress(
        cloud,
        triangles,
        use,
        grid.x0,
        grid.y0,
        grid.posting,
        owner,
        sigma_f,
        length_scale,
        sigma_eps,
        mean,
        variance,
        observed,
    )


def _merge_coincident(cloud: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cloud with samples at the same (x, y) replaced by their mean height."""
    xy, inverse, count = np.unique(cloud[:, :2], axis=0, return_inverse=True, return_counts=True)
    if len(xy) == len(cloud):
        return cloud
    z = np.bincount(inverse.ravel(), weights=cloud[:, 2]) / count
    return np.column_stack((xy, z))


def fuse(first: GaussianDem, second: GaussianDem) -> GaussianDem:
    """Return the precision-weighted mean of two maps of the same grid.

    Where one map has not observed a cell the other's value stands; where both have, the errors
    are taken as independent.
    """
    if first.grid != second.grid:
        raise ValueError("the maps lie on different grids")
    w1 = np.where(first.observed, 1.0 / np.maximum(first.variance, 1e-12), 0.0)
    w2 = np.where(second.observed, 1.0 / np.maximum(second.variance, 1e-12), 0.0)
    both = w1 + w2
    known = both > 0.0
    safe = np.where(known, both, 1.0)
    m1 = np.where(first.observed, first.mean, 0.0)
    m2 = np.where(second.observed, second.mean, 0.0)
    fallback = np.where(np.isfinite(second.mean), second.mean, first.mean)
    mean = np.where(known, (w1 * m1 + w2 * m2) / safe, fallback)
    prior = np.maximum(first.variance, second.variance)
    variance = np.where(known, 1.0 / safe, prior)
    return GaussianDem(first.grid, mean.astype(np.float32), variance.astype(np.float32), known)
