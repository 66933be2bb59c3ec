"""The Gaussian DEM: local random field regression on a Delaunay triangulation."""

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
)
from lunarsim.triangulation import delaunay, delaunay_of_image
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.value_checks import as_real_array

FloatMap = NDArray[np.float32]
BoolMap = BoolArray

# Bilinear weight above which a cell is measured and not interpolated.
MIN_MEASURED_WEIGHT = 0.5
# Pixel numbers of points without a detector.
NO_PIXELS = np.zeros(0, np.int64)
# Maximum length parameter of the field, m: its square fits float32.
_MAX_LENGTH_M = 1e9
# Number of neighbours from which the sample spacing is estimated if the sensor does not state it.
_NEIGHBOUR_COUNT = 6


@dataclass(frozen=True)
class GaussianDem:
    """Elevation raster with mean and variance of each cell.

    Attributes
    ----------
    grid
        Positions of the cells; values belong to cell centres.
    mean
        Mean elevation (rows, cols), m; NaN where unknown.
    variance
        Variance of the elevation (rows, cols), m^2; the prior variance where unknown.
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
    """Build a raster with mean and variance of the elevation from a point cloud.

    Implements section II of the Gaussian DEM paper. Cells with enough samples take the value of the
    conventional DEM and the variance of a sample. Other cells take the regression of Eqs. 5 and 6,
    with the kernel of Eq. 4, from the vertices of the Delaunay triangle that contains them. The
    prior mean is the mean of these vertices, because a prior mean of zero would pull the terrain
    towards z = 0.

    Parameters
    ----------
    points
        East, north, up (n, 3), m; rows with NaN are ignored.
    grid
        Cells of the DEM.
    sigma_f
        Prior standard deviation of the terrain, m.
    length_scale
        Length scale of the kernel, m. If it is much longer than the triangles, only sigma_f^2 /
        length_scale matters.
    sigma_eps
        Standard deviation of a sample, m.
    image_shape
        Rows and columns of the detector, if the points are its returns in order. The triangulation
        then starts from the pixel mesh and recognizes triangles over missing returns.
    spacing
        Distance of neighbouring samples, scalar or (n,), m, as from `LidarScan.spacing`. A triangle
        with an edge longer than three times this spacing is an occlusion. Default: distance of
        neighbouring pixels, or without `image_shape` the mean distance to the six nearest samples.

    Raises
    ------
    ValueError
        If the array is not (n, 3), contains infinities, `sigma_f` or `length_scale` is not
        positive, `sigma_eps` is negative, a height exceeds 8 km, or `image_shape` does not have one
        pixel per point.

    Examples
    --------
    >>> grid = Grid.centred((0.0, 0.0), 4.0, 1.0)
    >>> x, y = np.meshgrid(grid.x, grid.y)
    >>> dem = gaussian_dem(np.column_stack((x.ravel(), y.ravel(), 0.1 * x.ravel())), grid)
    >>> np.allclose(dem.mean, 0.1 * x), bool(dem.observed.all())
    (True, True)
    """
    _check_parameters(sigma_f, length_scale, sigma_eps)
    raw = as_real_array("points", points)
    cloud = check_points(raw)
    base = base_height(cloud)
    check_heights(cloud)
    height, weight = k.splat(cloud, base, grid.x0, grid.y0, grid.posting, grid.rows, grid.cols)
    mean, variance = np.empty(grid.shape, np.float32), np.empty(grid.shape, np.float32)
    observed = np.empty(grid.shape, np.bool_)
    k.write_measured_cells(
        height, weight, base, MIN_MEASURED_WEIGHT, sigma_eps * sigma_eps, sigma_f * sigma_f,
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
    """Interpolate the unmeasured cells of `dem` in place, with one random field.

    `mesh` is the triangulation of the samples and `weight` (rows, cols) their bilinear weights.
    `field` holds the variance of the field, m^2, its length scale, m, and the variance of a sample,
    m^2.
    """
    prior, length, noise = field
    count, grid = len(mesh.triangles), dem.grid
    if count:
        k.regress(
            mesh.vertices, np.full(len(mesh.vertices), noise), mesh.triangles, mesh.usable,
            np.zeros((count, 2)), grid.x0, grid.y0, grid.posting, np.full(count, prior),
            np.full(count, length), weight, np.float32(MIN_MEASURED_WEIGHT), dem.mean, dem.variance,
            dem.observed,
        )  # fmt: skip


def _check_parameters(sigma_f: float, length_scale: float, sigma_eps: float) -> None:
    """Raise InputError if a parameter of the random field is out of range.

    `sigma_f` is the prior standard deviation, `length_scale` that of the kernel and `sigma_eps` the
    standard deviation of a sample, m.
    """
    for name, value in (("sigma_f", sigma_f), ("length_scale", length_scale)):
        if not 0.0 < value <= _MAX_LENGTH_M:
            raise InputError(name, value, f"must be positive and at most {_MAX_LENGTH_M:g} m")
    if not 0.0 <= sigma_eps <= _MAX_LENGTH_M:
        raise InputError("sigma_eps", sigma_eps, f"must be between 0 and {_MAX_LENGTH_M:g} m")


def triangle_edges(
    points: Array,
    triangles: IntArray,
    pixels: IntArray,
    cols: int,
    spacing: Array,
) -> tuple[Array, BoolMap]:
    """Return the longest edge of each triangle (m,), m, and which are usable (m,).

    A triangle is not usable for interpolation if it covers missing returns (its longest edge is
    then inf) or if an edge exceeds three times the sample spacing.

    Parameters
    ----------
    points
        Vertices (n, 3), m.
    triangles
        Indices of vertices (m, 3).
    pixels
        Row-major pixel numbers of the points on the detector (n,); empty if unknown.
    cols
        Columns of the detector.
    spacing
        Sample spacing at each vertex (n,), m; the limit of a triangle uses the maximum over its
        corners.
    """
    longest, usable = np.empty(len(triangles)), np.empty(len(triangles), np.bool_)
    # Integer division is slow: divide once per pixel, not once per edge.
    row, col = np.divmod(pixels, cols)
    k.measure_edges(points, triangles, row, col, spacing, longest, usable)
    return longest, usable


@dataclass(frozen=True)
class _Mesh:
    """Delaunay triangulation of a point cloud.

    Attributes
    ----------
    vertices
        Points (n, 3), m.
    triangles
        Indices into `vertices` (m, 3).
    usable
        False for triangles that span an occlusion (m,).
    """

    vertices: Array
    triangles: IntArray
    usable: BoolMap

    @classmethod
    def of(
        cls,
        raw: Array,
        cloud: Array,
        image_shape: tuple[int, int] | None,
        spacing: ArrayLike | None,
    ) -> _Mesh:
        """Triangulate the finite points of a detector image or of a point cloud.

        `raw` (n, 3) are all points and `cloud` the finite ones, m. `image_shape` is (rows, columns)
        of the detector, or None for a cloud. `spacing` is the sample spacing, scalar or (n,), m, or
        None to estimate it from the points.
        """
        if image_shape is None:
            return cls._of_cloud(raw, cloud, spacing)
        if len(raw) != image_shape[0] * image_shape[1]:
            raise ValueError(
                f"image_shape: rows times columns must be {len(raw)}, the number of points, "
                f"got {image_shape}."
            )
        triangles = delaunay_of_image(_xy_of_finite(raw), image_shape)
        pixels = np.arange(len(raw))
        pixel_spacing = _pixel_spacing(raw, image_shape) if spacing is None else spacing
        point_spacing = np.ascontiguousarray(
            np.broadcast_to(np.asarray(pixel_spacing, np.float64), len(raw))
        )
        return cls(
            raw, triangles, triangle_edges(raw, triangles, pixels, image_shape[1], point_spacing)[1]
        )

    @classmethod
    def _of_cloud(cls, raw: Array, cloud: Array, spacing: ArrayLike | None) -> _Mesh:
        """Triangulate the finite points of a cloud after merging coincident points.

        `raw` (n, 3) are all points and `cloud` the finite ones, m. `spacing` is the sample spacing,
        scalar or (n,), m; None: the mean distance to the six nearest points.
        """
        vertices, group = _merge_coincident(cloud)
        triangles = delaunay(vertices[:, :2])
        if spacing is None:
            vertex_spacing = sample_spacing(vertices)
        else:
            given = np.broadcast_to(np.asarray(spacing, dtype=np.float64), len(raw))
            vertex_spacing = np.full(len(vertices), np.inf)
            np.minimum.at(vertex_spacing, group, given[finite_rows(raw)])
        return cls(
            vertices,
            triangles,
            triangle_edges(vertices, triangles, NO_PIXELS, 1, vertex_spacing)[1],
        )


def _pixel_spacing(raw: Array, shape: tuple[int, int]) -> float:
    """Return the median horizontal distance of points in neighbouring pixels, m.

    `raw` (n, 3) are the points of a detector with rows and columns `shape`. The result is the
    larger of the medians along the two axes of the detector. It is 0 if no two neighbours have a
    return: gaps and sparse samples then cannot be distinguished.
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


def sample_spacing(points: Array) -> Array:
    """Return the mean horizontal distance of each point to its six nearest points, m.

    `points` has shape (n, 2 or more), the result (n,). With fewer points all others are used; a
    single point gets inf.
    """
    nearest = min(_NEIGHBOUR_COUNT, len(points) - 1)
    if nearest < 1:
        return np.full(len(points), np.inf)
    distance, _ = cKDTree(points[:, :2]).query(points[:, :2], k=nearest + 1, workers=-1)
    return np.asarray(distance[:, 1:].mean(axis=1))


def _xy_of_finite(points: Array) -> Array:
    """Return (x, y) of the points, with NaN for every point that lacks a coordinate."""
    xy = points[:, :2]
    lost = ~finite_rows(points)
    return np.where(lost[:, None], np.nan, xy) if lost.any() else xy


def _merge_coincident(
    cloud: Array,
) -> tuple[Array, IntArray]:
    """Merge points at the same (x, y) into one point with their mean height.

    `cloud` (n, 3) are the points, m. Returns the merged points (m, 3) and the index (n,) of the
    merged point of each given point.
    """
    order = np.lexsort((cloud[:, 1], cloud[:, 0]))
    same = (np.diff(cloud[order, :2], axis=0) == 0.0).all(axis=1)
    if not same.any():
        return cloud, np.arange(len(cloud))
    group = np.concatenate(([0], np.cumsum(~same)))
    first = order[np.concatenate(([True], ~same))]
    count = np.bincount(group)
    z = np.bincount(group, weights=cloud[order, 2]) / count
    row_of = np.empty(len(cloud), np.int64)
    row_of[order] = group
    return np.column_stack((cloud[first, :2], z)), row_of
