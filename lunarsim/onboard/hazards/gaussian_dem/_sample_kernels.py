# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled kernels of pooled samples and of the terrain roughness between them."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

# Standard deviations by which the peak of a cell is below its highest sample: the noise of the
# thousand samples under a lander rarely exceeds it.
PEAK_SIGMAS = 4.0


@kernel()
def add_points(
    points, base, sigma, spacing, raster, centroid, splat, call_weight, min_spacing, peak
):
    """Add points (n, 3) to the sums of a `SamplePool`; return how many hit the grid.

    `base` is the reference height, m; `sigma` (n,) and `spacing` (n,) are standard deviation and
    spacing of each sample, m. `raster` is (x0, y0, cell size), m, with the centre (x0, y0) of cell
    (0, 0). `centroid` and the last three entries of `splat` (rows, cols, 4), the sums of the pool,
    `min_spacing` (rows, cols), its minimum spacings, and `peak` (rows, cols), its maximum heights
    minus `PEAK_SIGMAS` standard deviations, are updated. The bilinear weights of the
    given points are added to `call_weight` (rows, cols). Points off the grid are skipped.
    """
    x0, y0, p = raster
    rows, cols = min_spacing.shape
    count = 0
    for n in range(points.shape[0]):
        u = (points[n, 0] - x0) / p
        v = (points[n, 1] - y0) / p
        if not (u > -1.0 and v > -1.0 and u < cols and v < rows):
            continue
        z = points[n, 2] - base
        precision = 1.0 / (sigma[n] * sigma[n])
        j = int(np.floor(u + 0.5))
        i = int(np.floor(v + 0.5))
        if i >= 0 and i < rows and j >= 0 and j < cols:
            count += 1
            centroid[i, j, 0] += precision
            centroid[i, j, 1] += precision * (u - j) * p
            centroid[i, j, 2] += precision * (v - i) * p
            centroid[i, j, 3] += precision * z
            min_spacing[i, j] = min(min_spacing[i, j], spacing[n])
            peak[i, j] = max(peak[i, j], z - PEAK_SIGMAS * sigma[n])
        j = int(np.floor(u))
        i = int(np.floor(v))
        for b in range(2):
            for a in range(2):
                r = i + b
                c = j + a
                if r < 0 or r >= rows or c < 0 or c >= cols:
                    continue
                weight = (u - j if a == 1 else 1.0 - u + j) * (v - i if b == 1 else 1.0 - v + i)
                call_weight[r, c] += weight
                splat[r, c, 1] += weight * precision
                splat[r, c, 2] += weight * precision * z
                splat[r, c, 3] += weight * weight * precision
    return count


@kernel(shared=True, allocates=False)
def sum_edge_increments(thread_slice, points, variance, triangles, gradient, out):
    """Sum squared height differences and lengths over the edges of each triangle.

    `out` (m, 2) receives the sum of the squared height differences minus the noise variance of both
    ends, m^2, and twice the sum of the edge lengths, m. Their ratio is the slope of the variogram
    at the origin. `points` (n, 3), m, are vertices with variances `variance` (n,), m^2; `triangles`
    (m, 3) are their indices. Height differences are relative to the terrain slope `gradient` (m,
    2). `thread_slice` is (thread, number of threads).
    """
    for t in range(thread_slice[0], triangles.shape[0], thread_slice[1]):
        grown = 0.0
        length = 0.0
        for e in range(3):
            a = triangles[t, e]
            b = triangles[t, (e + 1) % 3]
            dx = points[b, 0] - points[a, 0]
            dy = points[b, 1] - points[a, 1]
            d = points[b, 2] - points[a, 2] - gradient[t, 0] * dx - gradient[t, 1] * dy
            grown += d * d - variance[a] - variance[b]
            length += 2.0 * np.sqrt(dx * dx + dy * dy)
        out[t, 0] = grown
        out[t, 1] = length


@kernel(shared=True, allocates=False)
def write_measured_cells(
    thread_slice, splat, base, min_weight, variogram_slope, square_cells, mean_offset,
    prior_variance, mean, variance, observed,
):  # fmt: skip
    """Write mean, variance and observation flag of cells with enough pooled samples.

    `splat` (rows, cols, 4) are the sums of `SamplePool`, with heights above `base`, m. Cells with a
    weight of at most `min_weight` get a NaN mean, the variance `prior_variance`, m^2, and the flag
    False. The other cells get the weighted mean of their samples and its variance, increased by
    ``mean_offset * slope / max(weight, 1)``: `mean_offset`, m, is the effective distance of a
    sample from the cell centre, and `variogram_slope`, m, holds the slope of the variogram at the
    origin for each square of `square_cells` x `square_cells` cells. `mean`, `variance` and
    `observed` (rows, cols) receive the results. `thread_slice` is (thread, number of threads).
    """
    rows, cols = mean.shape
    for i in range(thread_slice[0], rows, thread_slice[1]):
        for j in range(cols):
            if splat[i, j, 0] > min_weight:
                w = splat[i, j, 1]
                mean[i, j] = base + splat[i, j, 2] / w
                offset_variance = (
                    mean_offset
                    * variogram_slope[i // square_cells, j // square_cells]
                    / max(splat[i, j, 0], 1.0)
                )
                variance[i, j] = splat[i, j, 3] / (w * w) + offset_variance
                observed[i, j] = True
            else:
                mean[i, j] = np.nan
                variance[i, j] = prior_variance
                observed[i, j] = False


@kernel(shared=True, allocates=False)
def add_curvature_variance(thread_slice, mean, is_measured, noise, factor, variance):
    """Increase the variance of measured cells where the terrain is strongly curved.

    At the edge of a rock the samples of a cell lie above or below its centre. The curvature is the
    difference of a cell's `mean` (rows, cols), m, from the average of two opposite neighbours; the
    maximum over four directions is used. If its square exceeds nine times its variance, `factor`
    times the excess is added to `variance` (rows, cols), m^2; otherwise it is unchanged. `noise`
    (rows, cols), m^2, is the variance of `mean`, from which the variance of the curvature follows.
    `is_measured` (rows, cols) selects the cells. `thread_slice` is (thread, number of threads).
    """
    rows, cols = mean.shape
    for i in range(thread_slice[0], rows, thread_slice[1]):
        for j in range(cols):
            if not is_measured[i, j]:
                continue
            max_curvature = 0.0
            for di, dj in ((0, 1), (1, 0), (1, 1), (1, -1)):
                if i < di or i + di >= rows or j < abs(dj) or j + abs(dj) >= cols:
                    continue  # at the edge of the map only one direction exists
                bend = 0.5 * (mean[i + di, j + dj] + mean[i - di, j - dj]) - mean[i, j]
                if np.isfinite(bend):
                    max_curvature = max(max_curvature, bend * bend)
            excess = max_curvature - 13.5 * noise[i, j]
            if excess > 0.0:
                variance[i, j] += factor * excess
