# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled kernels of pooled samples and of the terrain roughness between them."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def pool(points, base, sigma, spacing, frame, centroid, splat, call_weight, min_spacing):
    """Add points (n, 3) to the sums of a `SamplePool`; return how many hit the grid.

    `base` is the reference height, m; `sigma` (n,) and `spacing` (n,) are standard deviation and
    spacing of each sample, m. `frame` is (x0, y0, cell size), m. `centroid` and `splat` (rows,
    cols, 4) are the sums, `min_spacing` (rows, cols) the minimum spacings. `call_weight` (rows,
    cols) receives the bilinear weights of the given points only.
    """
    x0, y0, p = frame
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
def triangle_growth(share, points, variance, triangles, gradient, out):
    """Sum squared height differences and lengths over the edges of each triangle.

    `out` (m, 2) receives the sum of the squared height differences minus the noise variance of both
    ends, m^2, and twice the sum of the edge lengths, m. Their ratio is the slope of the variogram
    at the origin. `points` (n, 3), m, are vertices with variances `variance` (n,), m^2; `triangles`
    (m, 3) are their indices. Height differences are relative to the terrain slope `gradient` (m,
    2). `share` is (thread, number of threads).
    """
    for t in range(share[0], triangles.shape[0], share[1]):
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
def measured_pool(
    share, splat, base, min_weight, growth, square, sub, prior, mean, variance, observed
):
    """Write mean, variance and observation flag of cells with enough pooled samples.

    `splat` (rows, cols, 4) are the sums of `SamplePool`, with heights above `base`, m. Cells with a
    weight of at most `min_weight` get a NaN mean, the variance `prior`, m^2, and the flag False.
    `growth`, m, is the slope of the variogram at the origin, in squares of `square` cells. `sub` is
    the effective distance of a sample from the cell centre, m: `sub` times `growth` is the variance
    of their height difference, m^2, which falls with the number of samples. `mean`, `variance` and
    `observed` (rows, cols) receive the results. `share` is (thread, number of threads).
    """
    rows, cols = mean.shape
    for i in range(share[0], rows, share[1]):
        for j in range(cols):
            if splat[i, j, 0] > min_weight:
                w = splat[i, j, 1]
                mean[i, j] = base + splat[i, j, 2] / w
                offset_variance = sub * growth[i // square, j // square] / max(splat[i, j, 0], 1.0)
                variance[i, j] = splat[i, j, 3] / (w * w) + offset_variance
                observed[i, j] = True
            else:
                mean[i, j] = np.nan
                variance[i, j] = prior
                observed[i, j] = False


@kernel(shared=True, allocates=False)
def add_kinks(share, mean, measured, noise, part, variance):
    """Add the terrain curvature to the variance of measured cells.

    On the edge of a rock the samples of a cell lie above or below its centre. The curvature is the
    second difference of `mean` (rows, cols), m, the maximum of four directions. Its square minus
    nine times its variance, times `part`, is added to `variance` (rows, cols), m^2, if it is
    positive. `noise` (rows, cols), m^2, is the variance of the mean. `measured` (rows, cols)
    selects the cells. `share` is (thread, number of threads).
    """
    rows, cols = mean.shape
    for i in range(share[0], rows, share[1]):
        for j in range(cols):
            if not measured[i, j]:
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
                variance[i, j] += part * excess
