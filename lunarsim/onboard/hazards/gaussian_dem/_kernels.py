# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled kernels of the conventional and the Gaussian DEM."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def splat(points, base, x0, y0, posting, rows, cols):
    """Distribute points (n, 3) over the four nearest cell centres of a raster.

    The weights are bilinear (Eq. 1 of the Gaussian DEM paper). `base` is the reference of the
    heights, m; (`x0`, `y0`) is the centre of cell (0, 0). Points with NaN and points without a cell
    centre nearby are skipped. Returns the sum of weighted heights above `base` and the sum of
    weights of each cell, both (rows, cols).
    """
    height = np.zeros((rows, cols), np.float32)
    weight = np.zeros((rows, cols), np.float32)
    for n in range(points.shape[0]):
        u = (points[n, 0] - x0) / posting
        v = (points[n, 1] - y0) / posting
        z = points[n, 2] - base
        # This form of the comparison rejects NaN.
        if not (u > -1.0 and v > -1.0 and u < cols and v < rows and np.isfinite(z)):
            continue
        j = int(np.floor(u))
        i = int(np.floor(v))
        fu = u - j
        fv = v - i
        for b in range(2):
            for a in range(2):
                r = i + b
                c = j + a
                if r >= 0 and r < rows and c >= 0 and c < cols:
                    w = (fu if a == 1 else 1.0 - fu) * (fv if b == 1 else 1.0 - fv)
                    height[r, c] += w * z
                    weight[r, c] += w
    return height, weight


@kernel(shared=True, allocates=False)
def write_measured_cells(
    thread_slice, height, weight, base, min_weight, sample_variance, prior_variance, mean,
    variance, observed,
):  # fmt: skip
    """Write mean, variance and observation flag of the cells with enough samples.

    Cells with a weight of at most `min_weight` get a NaN mean, the variance `prior_variance` (m^2)
    and the flag False; the others get the variance `sample_variance`. `height` and `weight` (rows,
    cols) are the results of `splat` with the reference height `base`, m. `mean`, `variance` and
    `observed` (rows, cols) receive the results. `thread_slice` is (thread, number of threads).
    """
    rows, cols = height.shape
    for i in range(thread_slice[0], rows, thread_slice[1]):
        for j in range(cols):
            if weight[i, j] > min_weight:
                mean[i, j] = base + np.float64(height[i, j]) / np.float64(weight[i, j])
                variance[i, j] = sample_variance
                observed[i, j] = True
            else:
                mean[i, j] = np.nan
                variance[i, j] = prior_variance
                observed[i, j] = False


@kernel()
def fill_holes(elevation):
    """Fill NaN cells of a raster in place with the mean of their known neighbours.

    The step is repeated until no cell can be filled.
    """
    rows, cols = elevation.shape
    holes = np.empty((rows * cols, 2), np.int64)
    count = 0
    for i in range(rows):
        for j in range(cols):
            if np.isnan(elevation[i, j]):
                holes[count, 0] = i
                holes[count, 1] = j
                count += 1
    value = np.empty(count)
    while count > 0:
        for n in range(count):
            total = 0.0
            known = 0
            for i in range(max(holes[n, 0] - 1, 0), min(holes[n, 0] + 2, rows)):
                for j in range(max(holes[n, 1] - 1, 0), min(holes[n, 1] + 2, cols)):
                    if not np.isnan(elevation[i, j]):
                        total += elevation[i, j]
                        known += 1
            value[n] = total / known if known > 0 else np.nan
        kept = 0
        for n in range(count):
            i = holes[n, 0]
            j = holes[n, 1]
            if np.isnan(value[n]):
                holes[kept, 0] = i
                holes[kept, 1] = j
                kept += 1
            else:
                elevation[i, j] = value[n]
        if kept == count:
            break  # no known cell at all
        count = kept


_MAX_PIXEL_DISTANCE = (
    2  # vertices that are farther apart on the detector have a missing return between them
)


# A triangle spans an occlusion if an edge exceeds the sample spacing by this factor.
_OCCLUSION_RATIO = 3.0


@kernel(shared=True, allocates=False)
def measure_edges(thread_slice, points, triangles, row, col, spacing, longest, usable):
    """Compute the longest edge of each triangle and whether to interpolate over it.

    `points` (n, 3), m, are the vertices with detector positions `row` and `col` (n,), which may be
    empty, and sample spacings `spacing` (n,), m. `triangles` (m, 3) are indices of vertices.
    `longest` (m,), m, and `usable` (m,) receive the results. A triangle over missing returns gets
    the length inf. A triangle is usable if no edge exceeds three times the sample spacing.
    `thread_slice` is (thread, number of threads).
    """
    for t in range(thread_slice[0], triangles.shape[0], thread_slice[1]):
        max_square = 0.0
        pixel_distance = 0
        max_spacing = 0.0
        for e in range(3):
            a = triangles[t, e]
            b = triangles[t, (e + 1) % 3]
            dx = points[a, 0] - points[b, 0]
            dy = points[a, 1] - points[b, 1]
            max_square = max(max_square, dx * dx + dy * dy)
            max_spacing = max(max_spacing, spacing[a])
            if row.size > 0:
                pixel_distance = max(pixel_distance, abs(row[a] - row[b]), abs(col[a] - col[b]))
        longest[t] = np.sqrt(max_square) if pixel_distance <= _MAX_PIXEL_DISTANCE else np.inf
        usable[t] = longest[t] <= _OCCLUSION_RATIO * max_spacing


@kernel(fast=True)
def _decay(x):
    """Return exp(-x), by a polynomial with an error below 2e-11 for x < 0.1."""
    if x < 0.1:
        return 1.0 - x * (
            1.0
            - x
            * (1 / 2)
            * (1.0 - x * (1 / 3) * (1.0 - x * (1 / 4) * (1.0 - x * (1 / 5) * (1.0 - x * (1 / 6)))))
        )
    return np.exp(-x)


@kernel(fast=True)
def _correlation(x, y, u, v, per_length):
    """Return the exponential correlation of the heights at points (x, y) and (u, v).

    It is the kernel of Eq. 4 of the Gaussian DEM paper for unit variance; `per_length` is the
    inverse of the length scale, 1/m.
    """
    return _decay(np.sqrt((x - u) * (x - u) + (y - v) * (y - v)) * per_length)


@kernel()
def _edge(points, u, v):
    """Return start, direction and orientation of the edge from vertex u to vertex v.

    `points` (n, 3) are all vertices, and the result is (x, y, dx, dy, whether u < v). Both
    triangles at an edge get the same start and direction, from the lower index to the higher.
    Rounding then assigns each cell on the edge to exactly one triangle.
    """
    first, last = min(u, v), max(u, v)
    x, y = points[first, 0], points[first, 1]
    return x, y, points[last, 0] - x, points[last, 1] - y, u < v


@kernel()
def _inside(edge, x, north_term):
    """Return whether a point lies on the inner side of a triangle edge.

    `edge` is the result of `_edge`, `x` the east coordinate of the point, and `north_term` the part
    of the cross product that depends on its north coordinate only. A point on the edge belongs to
    the triangle that traverses the edge from the lower index.
    """
    return (north_term - edge[3] * (x - edge[0]) >= 0.0) == edge[4]


@kernel()
def _regress_triangle(
    points, noise, a, b, c, is_usable, gradient, x0, y0, posting, prior, length_scale, weight,
    min_weight, mean, variance, observed,
):  # fmt: skip
    """Write the regressed height and variance of the unmeasured cells in one triangle.

    `a`, `b` and `c` are the indices of its vertices among `points` (n, 3). `mean`, `variance` and
    `observed` (rows, cols) are written in cells with a weight of at most `min_weight`. If
    `is_usable` is False, because the triangle spans an occlusion, only `mean` is written. The other
    arguments are those of `regress`, for one triangle.
    """
    rows, cols = mean.shape
    ax, ay = points[a, 0], points[a, 1]
    bx, by = points[b, 0], points[b, 1]
    cx, cy = points[c, 0], points[c, 1]
    i0 = max(int(np.ceil((min(min(ay, by), cy) - y0) / posting)), 0)
    i1 = min(int(np.floor((max(max(ay, by), cy) - y0) / posting)), rows - 1)
    j0 = max(int(np.ceil((min(min(ax, bx), cx) - x0) / posting)), 0)
    j1 = min(int(np.floor((max(max(ax, bx), cx) - x0) / posting)), cols - 1)
    if i0 > i1 or j0 > j1:
        return
    # Gram matrix and its inverse, both symmetric.
    da, db, dc = prior + noise[a], prior + noise[b], prior + noise[c]
    per_length = 1.0 / length_scale
    ab = prior * _correlation(ax, ay, bx, by, per_length)
    ac = prior * _correlation(ax, ay, cx, cy, per_length)
    bc = prior * _correlation(bx, by, cx, cy, per_length)
    maa = db * dc - bc * bc
    mab = ac * bc - ab * dc
    mac = ab * bc - ac * db
    mbb = da * dc - ac * ac
    mbc = ab * ac - bc * da
    mcc = da * db - ab * ab
    per_det = 1.0 / (da * maa + ab * mab + ac * mac)
    centre = (points[a, 2] + points[b, 2] + points[c, 2]) / 3.0
    gx, gy = gradient[0], gradient[1]
    mx, my = (ax + bx + cx) / 3.0, (ay + by + cy) / 3.0
    za = points[a, 2] - centre - gx * (ax - mx) - gy * (ay - my)
    zb = points[b, 2] - centre - gx * (bx - mx) - gy * (by - my)
    zc = points[c, 2] - centre - gx * (cx - mx) - gy * (cy - my)
    edge_ab, edge_bc, edge_ca = _edge(points, a, b), _edge(points, b, c), _edge(points, c, a)
    for i in range(i0, i1 + 1):
        y = y0 + posting * i
        first = edge_ab[2] * (y - edge_ab[1])
        second = edge_bc[2] * (y - edge_bc[1])
        third = edge_ca[2] * (y - edge_ca[1])
        for j in range(j0, j1 + 1):
            if weight[i, j] > min_weight:
                continue
            x = x0 + posting * j
            if not (
                _inside(edge_ab, x, first)
                & _inside(edge_bc, x, second)
                & _inside(edge_ca, x, third)
            ):
                continue
            ka = prior * _correlation(ax, ay, x, y, per_length)
            kb = prior * _correlation(bx, by, x, y, per_length)
            kc = prior * _correlation(cx, cy, x, y, per_length)
            wa = (maa * ka + mab * kb + mac * kc) * per_det
            wb = (mab * ka + mbb * kb + mbc * kc) * per_det
            wc = (mac * ka + mbc * kb + mcc * kc) * per_det
            trend = centre + gx * (x - mx) + gy * (y - my)
            mean[i, j] = trend + wa * za + wb * zb + wc * zc
            if is_usable:
                variance[i, j] = max(prior - (ka * wa + kb * wb + kc * wc), 0.0)
                observed[i, j] = True


@kernel(shared=True, allocates=False)
def regress(
    thread_slice, points, noise, triangles, usable, gradient, x0, y0, posting, prior, length,
    weight, min_weight, mean, variance, observed,
):  # fmt: skip
    """Interpolate unmeasured cells within triangles by Gaussian process regression.

    `mean`, `variance` and `observed` (rows, cols) receive the results of Eqs. 4 to 6 of the
    Gaussian DEM paper, from the three vertices of the triangle that contains the cell. `points` (n,
    3), m, are the vertices with variances `noise` (n,), m^2, and `triangles` (m, 3) their indices.
    (`x0`, `y0`) is the centre of cell (0, 0). Cells with a `weight` (rows, cols) above `min_weight`
    are measured and stay unchanged. `thread_slice` is (thread, number of threads).

    `prior` (m,), m^2, and `length` (m,), m, are variance and length scale of the random field in
    each triangle. Its mean is the plane through the centroid of the vertices with the slope
    `gradient` (m, 2). Triangles that are not `usable` (m,) span an occlusion: in their cells only
    `mean` is written, and `variance` and `observed` stay as they are.
    """
    for t in range(thread_slice[0], triangles.shape[0], thread_slice[1]):
        _regress_triangle(
            points, noise, triangles[t, 0], triangles[t, 1], triangles[t, 2], usable[t],
            gradient[t], x0, y0, posting, prior[t], length[t], weight, min_weight,
            mean, variance, observed,
        )  # fmt: skip
