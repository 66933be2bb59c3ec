"""The Gaussian DEM: local Gaussian random field regression on a Delaunay triangulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import _kernels as k
from lunarsim.onboard.hazards.gaussian_dem.conventional import (
    base_height,
    check_heights,
    check_points,
    finite_rows,
    plain,
)
from lunarsim.triangulation import delaunay, delaunay_of_image

FloatMap = NDArray[np.float32]
BoolMap = NDArray[np.bool_]

# A cell whose samples weigh more than this is measured, not interpolated.
DENSE = 0.5
# Of points that are no detector's.
NO_PIXELS = np.zeros(0, np.int64)
# Lengths of a random field that its variances, in single precision, can hold, m.
_LONGEST = 1e9
# Neighbours by which the distance of samples is judged where no sensor tells it.
_NEAREST = 6


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
    spacing: ArrayLike | None = None,
) -> GaussianDem:
    """Build a Gaussian DEM from a point cloud (section II of the Gaussian DEM paper).

    Cells with enough samples take the conventional DEM's value and the sensor's variance, the
    others the regression of Eqs. 5 and 6 with the kernel of Eq. 4 from the three vertices of the
    Delaunay triangle about them. The prior mean is theirs: zero would pull relief towards z = 0.

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
        Rows and columns of the detector, if the points are its returns in order: triangulation
        then starts from its mesh, and triangles over missing returns are known as such.
    spacing
        How far apart neighbouring samples lie, one or (n,), m (`LidarScan.spacing`): a triangle
        with an edge three times as long spans ground that was not seen. Left out: that of
        neighbouring pixels, or without `image_shape` the mean distance to a sample's six nearest.

    Raises
    ------
    ValueError
        If the array is not (n, 3), holds infinities, or a parameter is not positive; if a height
        is over 8 km, where float32 no longer tells millimetres.
    """
    _check_parameters(sigma_f, length_scale, sigma_eps)
    raw = plain(points)
    cloud = check_points(raw)
    base = base_height(cloud)
    check_heights(cloud)
    height, weight = k.splat(cloud, base, grid.x0, grid.y0, grid.posting, grid.rows, grid.cols)
    mean, variance = np.empty(grid.shape, np.float32), np.empty(grid.shape, np.float32)
    observed = np.empty(grid.shape, np.bool_)
    k.measured_cells(
        height, weight, base, DENSE, sigma_eps * sigma_eps, sigma_f * sigma_f,
        mean, variance, observed,
    )  # fmt: skip
    dem = GaussianDem(grid, mean, variance, observed)
    if not dem.observed.all():
        field = sigma_f**2, length_scale, sigma_eps**2
        _regress(dem, _Mesh.of(raw, cloud, image_shape, spacing), weight, field)
    return dem


def _regress(
    dem: GaussianDem, mesh: _Mesh, weight: FloatMap, field: tuple[float, float, float]
) -> None:
    """Fill the cells of a map that were not measured, with one field everywhere.

    `field` holds its variance, its length scale and the variance of a sample.
    """
    prior, length, noise = field
    count, grid = len(mesh.triangles), dem.grid
    if count:
        k.regress(
            mesh.vertices, np.full(len(mesh.vertices), noise), mesh.triangles, mesh.usable,
            np.zeros((count, 2)), grid.x0, grid.y0, grid.posting, np.full(count, prior),
            np.full(count, length), weight, np.float32(DENSE), dem.mean, dem.variance,
            dem.observed,
        )  # fmt: skip


def _check_parameters(sigma_f: float, length_scale: float, sigma_eps: float) -> None:
    for name, value in (("sigma_f", sigma_f), ("length_scale", length_scale)):
        if not 0.0 < value <= _LONGEST:
            raise InputError(name, value, f"a positive length of at most {_LONGEST:g} m")
    if not 0.0 <= sigma_eps <= _LONGEST:
        raise InputError("sigma_eps", sigma_eps, f"0, or a length of at most {_LONGEST:g} m")


def triangle_edges(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    pixels: NDArray[np.int64],
    cols: int,
    spacing: NDArray[np.float64],
) -> tuple[NDArray[np.float64], BoolMap]:
    """Return the longest edge of every triangle (m,), and which triangles span ground seen (m,).

    Not those over missing returns, whose longest edge is inf, nor those with an edge three times as
    long as their samples are apart: `spacing` (n,), the widest at a triangle's corners.
    `pixels` numbers the points row by row on a detector of `cols` columns; empty if unknown.
    """
    longest, usable = np.empty(len(triangles)), np.empty(len(triangles), np.bool_)
    # Whole divisions are slow: once a pixel, not once an edge.
    row, col = np.divmod(pixels, cols)
    k.edges(points, triangles, row, col, spacing, longest, usable)
    return longest, usable


@dataclass(frozen=True)
class _Mesh:
    """Delaunay triangulation of a cloud.

    Attributes
    ----------
    vertices
        (n, 3).
    triangles
        Indices into `vertices` (m, 3).
    usable
        False for triangles over ground that was not seen (m,).
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    usable: BoolMap

    @classmethod
    def of(
        cls,
        raw: NDArray[np.float64],
        cloud: NDArray[np.float64],
        image_shape: tuple[int, int] | None,
        spacing: ArrayLike | None,
    ) -> _Mesh:
        """Triangulate all points given, or the cloud of finite ones if they are no image."""
        if image_shape is None:
            return cls._of_cloud(raw, cloud, spacing)
        if len(raw) != image_shape[0] * image_shape[1]:
            raise ValueError(f"image_shape = {image_shape}: does not hold {len(raw)} points")
        triangles = delaunay_of_image(_blank(raw), image_shape)
        pixels = np.arange(len(raw))
        wide = _pixel_spacing(raw, image_shape) if spacing is None else spacing
        apart = np.ascontiguousarray(np.broadcast_to(np.asarray(wide, np.float64), len(raw)))
        return cls(raw, triangles, triangle_edges(raw, triangles, pixels, image_shape[1], apart)[1])

    @classmethod
    def _of_cloud(
        cls, raw: NDArray[np.float64], cloud: NDArray[np.float64], spacing: ArrayLike | None
    ) -> _Mesh:
        vertices, group = _merge_coincident(cloud)
        triangles = delaunay(vertices[:, :2])
        if spacing is None:
            apart = sample_spacing(vertices)
        else:
            given = np.broadcast_to(np.asarray(spacing, dtype=np.float64), len(raw))
            apart = np.full(len(vertices), np.inf)
            np.minimum.at(apart, group, given[finite_rows(raw)])
        return cls(vertices, triangles, triangle_edges(vertices, triangles, NO_PIXELS, 1, apart)[1])


def _pixel_spacing(raw: NDArray[np.float64], shape: tuple[int, int]) -> float:
    """Return the distance of neighbouring pixels' points in the direction of the longer one, m.

    0 if no two neighbours have a return: nothing then tells gaps from sparse samples.
    """
    image = raw[:, :2].reshape(*shape, 2)
    medians = [0.0]
    for axis in (0, 1):
        step = np.diff(image, axis=axis)
        gap = np.sqrt(step[..., 0] ** 2 + step[..., 1] ** 2)
        gap = gap[np.isfinite(gap)]
        if gap.size:
            medians.append(float(np.median(gap)))
    return max(medians)


def sample_spacing(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean distance (n,) of points (n, 2 or more) to their nearest neighbours, m."""
    nearest = min(_NEAREST, len(points) - 1)
    if nearest < 1:
        return np.full(len(points), np.inf)
    distance, _ = cKDTree(points[:, :2]).query(points[:, :2], k=nearest + 1, workers=-1)
    return np.asarray(distance[:, 1:].mean(axis=1))


def _blank(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points' (x, y) with every pixel that lacks a coordinate NaN as a whole."""
    xy = points[:, :2]
    lost = ~finite_rows(points)
    return np.where(lost[:, None], np.nan, xy) if lost.any() else xy


def _merge_coincident(
    cloud: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the cloud with samples at the same (x, y) replaced by their mean height.

    The second array (n,) tells in which row of it each sample ended.
    """
    order = np.lexsort((cloud[:, 1], cloud[:, 0]))
    same = (np.diff(cloud[order, :2], axis=0) == 0.0).all(axis=1)
    if not same.any():
        return cloud, np.arange(len(cloud))
    group = np.concatenate(([0], np.cumsum(~same)))
    first = order[np.concatenate(([True], ~same))]
    count = np.bincount(group)
    z = np.bincount(group, weights=cloud[order, 2]) / count
    of = np.empty(len(cloud), np.int64)
    of[order] = group
    return np.column_stack((cloud[first, :2], z)), of
