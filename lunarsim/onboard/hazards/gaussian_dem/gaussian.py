"""The Gaussian DEM: local Gaussian random field regression on a Delaunay triangulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import _kernels as k
from lunarsim.onboard.hazards.gaussian_dem.conventional import base_height, check_points
from lunarsim.triangulation import delaunay, delaunay_of_image

FloatMap = NDArray[np.float32]
BoolMap = NDArray[np.bool_]

# A cell whose samples weigh more than this is measured, not interpolated.
_DENSE = 0.5
# A triangle whose longest edge is this many times longer than the median one spans an occlusion.
_GAP = 3.0


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
    image_shape: tuple[int, int] | None = None,
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
    image_shape
        Rows and columns of the detector, if the points are its returns in order: the
        triangulation then starts from the detector's mesh, and triangles over missing returns
        are known as such.

    Raises
    ------
    ValueError
        If the array is not (n, 3), holds infinities, or a parameter is not positive.
    """
    _check_parameters(sigma_f, length_scale, sigma_eps)
    raw = np.asarray(points, dtype=np.float64)
    cloud = check_points(raw)
    base = base_height(cloud)
    height, weight = k.splat(cloud, base, grid.x0, grid.y0, grid.posting, grid.rows, grid.cols)
    mean = np.empty(grid.shape, np.float32)
    variance = np.empty(grid.shape, np.float32)
    observed = np.empty(grid.shape, np.bool_)
    k.measured_cells(
        height, weight, base, _DENSE, sigma_eps * sigma_eps, sigma_f * sigma_f,
        mean, variance, observed,
    )  # fmt: skip
    if not observed.all():
        mesh = _Mesh.of(raw, cloud, image_shape)
        if len(mesh.triangles):
            k.regress(
                mesh.vertices, mesh.triangles, mesh.longest, mesh.gap,
                grid.x0, grid.y0, grid.posting, sigma_f, length_scale, sigma_eps,
                weight, np.float32(_DENSE), mean, variance, observed,
            )  # fmt: skip
    return GaussianDem(grid, mean, variance, observed)


def _check_parameters(sigma_f: float, length_scale: float, sigma_eps: float) -> None:
    for name, value in (("sigma_f", sigma_f), ("length_scale", length_scale)):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} = {value}: must be a positive length in metres")
    if not (np.isfinite(sigma_eps) and sigma_eps >= 0.0):
        raise ValueError(f"sigma_eps = {sigma_eps}: must be 0 or a positive length in metres")


@dataclass(frozen=True)
class _Mesh:
    """Delaunay triangulation of a cloud.

    Attributes
    ----------
    vertices
        (n, 3).
    triangles
        Indices into `vertices` (m, 3).
    longest
        Longest edge of each triangle (m,), m; inf for one over missing returns.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    longest: NDArray[np.float64]

    @property
    def gap(self) -> float:
        """Longest edge that spans no occlusion, m."""
        return _GAP * float(np.median(self.longest))

    @classmethod
    def of(
        cls,
        raw: NDArray[np.float64],
        cloud: NDArray[np.float64],
        image_shape: tuple[int, int] | None,
    ) -> _Mesh:
        """Triangulate all points given, or the cloud of finite ones if they are no image."""
        pixels, cols = np.zeros(0, np.int64), 1
        if image_shape is None:
            vertices = _merge_coincident(cloud)
            triangles = delaunay(vertices[:, :2])
        else:
            if len(raw) != image_shape[0] * image_shape[1]:
                raise ValueError(f"image_shape = {image_shape}: does not hold {len(raw)} points")
            vertices, cols = raw, image_shape[1]
            pixels = np.arange(len(raw))
            triangles = delaunay_of_image(_blank(raw), image_shape)
        return cls(vertices, triangles, k.longest_edges(vertices, triangles, pixels, cols))


def _blank(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points' (x, y) with every pixel that lacks a coordinate NaN as a whole."""
    xy = points[:, :2]
    lost = np.asarray(~np.isfinite(points).all(axis=1))
    return np.where(lost[:, None], np.nan, xy) if lost.any() else xy


def _merge_coincident(cloud: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cloud with samples at the same (x, y) replaced by their mean height."""
    order = np.lexsort((cloud[:, 1], cloud[:, 0]))
    same = (np.diff(cloud[order, :2], axis=0) == 0.0).all(axis=1)
    if not same.any():
        return cloud
    group = np.concatenate(([0], np.cumsum(~same)))
    first = order[np.concatenate(([True], ~same))]
    count = np.bincount(group)
    z = np.bincount(group, weights=cloud[order, 2]) / count
    return np.column_stack((cloud[first, :2], z))


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
