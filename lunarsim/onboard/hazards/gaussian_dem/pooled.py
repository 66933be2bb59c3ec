"""Gaussian DEM of many scans, with a random field fitted to the local roughness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.onboard.hazards.gaussian_dem import _kernels as k
from lunarsim.onboard.hazards.gaussian_dem import _sample_kernels as sk
from lunarsim.onboard.hazards.gaussian_dem.gaussian import (
    MIN_MEASURED_WEIGHT,
    NO_PIXELS,
    FloatMap,
    GaussianDem,
    triangle_edges,
)
from lunarsim.onboard.hazards.gaussian_dem.samples import SamplePool
from lunarsim.onboard.hazards.local_planes import LocalPlaneGrid
from lunarsim.triangulation import delaunay
from lunarsim.typing import Array, IntArray

# Variance of the field relative to the height differences in a triangle: so large that only the
# corners determine the level of a triangle, and only the kernel's slope at the origin matters.
_PRIOR_VARIANCE_RATIO = 100.0
# Length scale over which unobserved terrain may deviate from the rest, m.
_UNOBSERVED_LENGTH_M = 30.0
# The growth of the complete map counts as this many squares in the estimate for each square.
_GLOBAL_WEIGHT_SQUARES = 1.0
# Minimum growth, m: even flat terrain has dust of millimetres.
_MIN_GROWTH_M = 1e-6
# Effective distance of a sample from the cell centre, in units of the posting.
_SAMPLE_DISTANCE_RATIO = 0.15
# Share of the squared terrain curvature that is added to the variance of a cell.
_CURVATURE_SHARE = 0.4
# Terrain is smoother within a triangle than along its edges ...
_INTERIOR_GROWTH_RATIO = 0.4
# ... but the growth of the triangle itself, times the second factor, counts if it exceeds the first
# factor times the noise: an object there is as high between its corners as at them, or higher.
_SIGNIFICANCE_RATIO, _SIGNIFICANT_GROWTH_FACTOR = 6.0, 2.2


@dataclass(frozen=True)
class SamplingStatistics:
    """Density, noise and residual heights of the samples of an elevation map.

    Attributes
    ----------
    density
        Samples per square metre around each cell (rows, cols), of the densest scan; one per cell
        where scans are sparser than the map.
    spacing
        Median distance of neighbouring samples within their scans, m.
    noise
        Median standard deviation of the samples, m.
    residual_heights
        Heights of the samples above a plane fitted to the terrain around them (n,), m.
    residual_raster
        The residual heights in the cells of their samples (rows, cols), m; NaN without a sample.
    """

    density: Array
    spacing: float
    noise: float
    residual_heights: Array
    residual_raster: NDArray[np.float32]


@dataclass(frozen=True)
class PooledDem(GaussianDem):
    """Elevation raster with mean, variance and the statistics of its samples.

    Attributes
    ----------
    sampling
        Density, noise and residual heights of the samples.
    peak
        Estimate of the highest terrain in each cell (rows, cols), m; NaN where unknown.
    """

    sampling: SamplingStatistics
    peak: FloatMap


def pooled_dem(pool: SamplePool) -> PooledDem:
    """Interpolate mean and variance of the elevation between all samples of a pool.

    The method is that of `gaussian_dem`, but mean and variance of the random field are estimated.
    Between close samples only the slope of the variogram of Eq. 4 of the Gaussian DEM paper at the
    origin matters: ``sigma_f^2 / length_scale``. It is estimated as the mean squared height
    difference along triangle edges, relative to the terrain slope and minus the noise, divided by
    twice their length. The estimate is made in squares of a few samples, and in a single triangle
    if its own estimate is significantly larger. Rocky and smooth terrain thus each get a separate
    variance. The mean of the field has the local terrain slope, so that noise larger than the
    height differences does not flatten it.
    """
    grid = pool.grid
    mean, variance = np.empty(grid.shape, np.float32), np.empty(grid.shape, np.float32)
    observed = np.empty(grid.shape, np.bool_)
    vertices, noise, spacing = pool.vertices()
    triangles = delaunay(vertices[:, :2]) if len(vertices) > 2 else np.zeros((0, 3), np.int64)
    # The pool keeps one sample per cell, so the spacing is at least the posting.
    vertex_spacing = np.maximum(spacing, grid.posting)
    longest, usable = triangle_edges(vertices, triangles, NO_PIXELS, 1, vertex_spacing)
    squares = LocalPlaneGrid.of(grid, longest[usable])
    first, second, third = _corners(vertices[:, :2], triangles)
    middles = (first + second + third) / 3.0
    planes = squares.fit_planes(vertices)
    gradient = squares.at(planes[..., 1:], middles)
    increments = np.empty((len(triangles), 2))
    sk.sum_edge_increments(vertices, noise, triangles, gradient, increments)
    growth = _variogram_growth(squares, middles[usable], increments[usable])
    weight = np.ascontiguousarray(pool.splat[..., 0], dtype=np.float32)
    sk.write_measured_cells(
        pool.splat, pool.base or 0.0, MIN_MEASURED_WEIGHT, growth, squares.cells,
        _SAMPLE_DISTANCE_RATIO * grid.posting, float(growth.max()) * _UNOBSERVED_LENGTH_M,
        mean, variance, observed,
    )  # fmt: skip
    if len(triangles) and not observed.all():
        noises = _corners(noise, triangles)
        # Noise adds the variance of both ends to the squared difference of each of three edges.
        noise_increments = 2.0 * (noises[0] + noises[1] + noises[2])
        own_increments = increments[:, 0] - (_SIGNIFICANCE_RATIO - 1.0) * noise_increments
        rate = np.maximum(
            _INTERIOR_GROWTH_RATIO * squares.at(growth, middles),
            _SIGNIFICANT_GROWTH_FACTOR * own_increments / increments[:, 1],
        )
        prior = _PRIOR_VARIANCE_RATIO * (np.maximum.reduce(noises) + rate * increments[:, 1])
        k.regress(
            vertices, noise, triangles, usable, gradient, grid.x0, grid.y0, grid.posting,
            prior, prior / rate, weight, np.float32(MIN_MEASURED_WEIGHT), mean, variance, observed,
        )  # fmt: skip
    measured = weight > MIN_MEASURED_WEIGHT
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_variance = pool.splat[..., 3] / pool.splat[..., 1] ** 2
    sk.add_curvature_variance(mean, measured, mean_variance, _CURVATURE_SHARE, variance)
    return PooledDem(
        grid,
        mean,
        variance,
        observed,
        _sampling_statistics(pool, vertices, noise, spacing, squares, planes),
        _highest_terrain(pool, mean, squares.at(planes[..., 1:], grid.centres().reshape(-1, 2))),
    )


def _highest_terrain(pool: SamplePool, mean: FloatMap, gradient: Array) -> FloatMap:
    """Estimate the highest terrain in each cell of a pool (rows, cols), m.

    The mean of a cell hides a rock that is narrower than the cell, and the highest sample lies
    below its top. The estimate exceeds the highest sample by as much as this exceeds the `mean`
    (rows, cols), m, of the cell and of its eight neighbours: on a cone, samples half a cell apart
    leave this much above the highest one. The heights of the samples are first reduced by
    `PEAK_SIGMAS` standard deviations and by what the slope of the terrain explains. `gradient`
    (rows cols, 2) is the slope at the cells.
    """
    slope = 0.5 * pool.grid.posting * np.abs(gradient).sum(axis=1).reshape(mean.shape)
    highest = np.maximum(mean, (pool.peak + (pool.base or 0.0) - slope).astype(np.float32))
    around = ndimage.maximum_filter(np.where(np.isnan(mean), -np.inf, mean), 3)
    return np.asarray(highest + np.maximum(highest - around, 0.0), dtype=np.float32)


def _sampling_statistics(
    pool: SamplePool,
    vertices: Array,
    noise: Array,
    spacing: Array,
    squares: LocalPlaneGrid,
    planes: Array,
) -> SamplingStatistics:
    """Compute density, noise and residual heights of the samples of a pool.

    `vertices` (n, 3), m, `noise` (n,), m^2, and `spacing` (n,), m, are the samples, their variances
    and spacings. `planes` are the terrain planes fitted in `squares`.
    """
    if not len(vertices):
        nothing = np.zeros(pool.grid.shape)
        unknown = np.full(pool.grid.shape, np.nan, np.float32)
        return SamplingStatistics(nothing, np.inf, np.inf, np.zeros(0), unknown)
    middle = float(np.median(spacing))
    # Average over about four samples each way.
    window = max(5, round(4.0 * middle / pool.grid.posting))
    # Cells without samples have an infinite spacing.
    closest = np.minimum(pool.spacing, pool.grid.posting).astype(np.float64)
    density = np.where(np.isfinite(pool.spacing), closest**-2.0, 0.0)
    residual_heights = vertices[:, 2] - squares.plane_heights(planes, vertices)
    residual_raster = np.full(pool.grid.shape, np.nan, np.float32)
    # Vertices are in the order of their cells.
    residual_raster[np.nonzero(pool.centroid[..., 0])] = residual_heights
    return SamplingStatistics(
        np.maximum(ndimage.uniform_filter(density, window), 0.0),
        middle,
        float(np.sqrt(np.median(noise))),
        residual_heights,
        residual_raster,
    )


def _corners(values: Array, triangles: IntArray) -> list[Array]:
    """Look up values (n, ...) at the three corners of triangles (m, 3).

    Returns three arrays (m, ...), one per corner.
    """
    return [values[corner] for corner in triangles.T]


def _variogram_growth(squares: LocalPlaneGrid, centres: Array, increments: Array) -> Array:
    """Estimate the slope of the variogram at the origin, m, in each square.

    `centres` (m, 2) are the centres of triangles between samples, and `increments` (m, 2) their
    sums from `sum_edge_increments`. The result has shape (square rows, square columns).
    """
    row, col = squares.grid.cell(centres[:, :2])
    rows, cols = squares.shape
    index = np.clip(row // squares.cells, 0, rows - 1) * cols
    index = index + np.clip(col // squares.cells, 0, cols - 1)
    rise, length = (
        np.bincount(index, weights=increments[:, n], minlength=rows * cols).reshape(squares.shape)
        for n in range(2)
    )
    if length.sum() <= 0.0:
        return np.full(squares.shape, _MIN_GROWTH_M)
    map_growth = max(rise.sum() / length.sum(), _MIN_GROWTH_M)
    prior_length = _GLOBAL_WEIGHT_SQUARES * length.sum() / np.count_nonzero(length)
    growth = (_sum_3x3(rise) + prior_length * map_growth) / (_sum_3x3(length) + prior_length)
    return np.asarray(np.maximum(growth, _MIN_GROWTH_M), dtype=np.float64)


def _sum_3x3(values: NDArray[Any]) -> Array:
    """Return the sum over the 3 x 3 neighbourhood of each entry (rows, cols)."""
    return np.asarray(9.0 * ndimage.uniform_filter(values, 3, mode="constant"))
