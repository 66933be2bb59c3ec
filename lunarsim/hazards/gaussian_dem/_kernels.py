"""Compiled kernels of the conventional and the Gaussian DEM."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange


@kernel()
def splat(points, x0, y0, p, rows, cols):
    """Spread points (n, 3) over the four nearest cell centres: Eq. 1, accumulated.

    Returns the weighted elevations and the weights (rows, cols).
    """
    elevation = np.zeros((rows, cols))
    weight = np.zeros((rows, cols))
    for n in range(points.shape[0]):
        u = (points[n, 0] - x0) / p
        v = (points[n, 1] - y0) / p
        z = points[n, 2]
        # Written so that NaN fails.
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
                    elevation[r, c] += w * z
                    weight[r, c] += w
    return elevation, weight


@kernel()
def fill_holes(z):
    """Fill NaN cells in place by the mean of their known neighbours, ring by ring."""
    rows, cols = z.shape
    left = np.empty((rows * cols, 2), np.int64)
    count = 0
    for i in range(rows):
        for j in range(cols):
            if np.isnan(z[i, j]):
                left[count, 0] = i
                left[count, 1] = j
                count += 1
    value = np.empty(count)
    while count > 0:
        for n in range(count):
            total = 0.0
            known = 0
            for i in range(max(left[n, 0] - 1, 0), min(left[n, 0] + 2, rows)):
                for j in range(max(left[n, 1] - 1, 0), min(left[n, 1] + 2, cols)):
                    if not np.isnan(z[i, j]):
                        total += z[i, j]
                        known += 1
            value[n] = total / known if known > 0 else np.nan
        kept = 0
        for n in range(count):
            i = left[n, 0]
            j = left[n, 1]
            if np.isnan(value[n]):
                left[kept, 0] = i
                left[kept, 1] = j
                kept += 1
            else:
                z[i, j] = value[n]
        if kept == count:
            break  # nothing known at all
        count = kept


@kernel()
def _invert3(m, out):
    """Write the inverse of a symmetric 3 x 3 matrix; return its determinant."""
    a = m[0, 0]
    b = m[0, 1]
    c = m[0, 2]
    d = m[1, 1]
    e = m[1, 2]
    f = m[2, 2]
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    out[0, 0] = (d * f - e * e) / det
    out[0, 1] = (c * e - b * f) / det
    out[0, 2] = (b * e - c * d) / det
    out[1, 1] = (a * f - c * c) / det
    out[1, 2] = (b * c - a * e) / det
    out[2, 2] = (a * d - b * b) / det
    out[1, 0] = out[0, 1]
    out[2, 0] = out[0, 2]
    out[2, 1] = out[1, 2]
    return det


@kernel()
def own_cells(points, triangles, x0, y0, p, todo, owner):
    """Write into `owner` (rows, cols) the triangle that holds each cell centre of `todo`.

    A centre on an edge belongs to the last triangle in the list that touches it, so every cell
    has one owner and the regression may run in parallel.
    """
    rows, cols = owner.shape
    for t in range(triangles.shape[0]):
        ax = points[triangles[t, 0], 0]
        ay = points[triangles[t, 0], 1]
        bx = points[triangles[t, 1], 0]
        by = points[triangles[t, 1], 1]
        cx = points[triangles[t, 2], 0]
        cy = points[triangles[t, 2], 1]
        if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) < 0.0:
            bx, by, cx, cy = cx, cy, bx, by
        i0 = max(int(np.ceil((min(ay, by, cy) - y0) / p)), 0)
        i1 = min(int(np.floor((max(ay, by, cy) - y0) / p)), rows - 1)
        j0 = max(int(np.ceil((min(ax, bx, cx) - x0) / p)), 0)
        j1 = min(int(np.floor((max(ax, bx, cx) - x0) / p)), cols - 1)
        for i in range(i0, i1 + 1):
            y = y0 + p * i
            for j in range(j0, j1 + 1):
                if todo[i, j]:
                    x = x0 + p * j
                    if (
                        (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0.0
                        and (cx - bx) * (y - by) - (cy - by) * (x - bx) >= 0.0
                        and (ax - cx) * (y - cy) - (ay - cy) * (x - cx) >= 0.0
                    ):
                        owner[i, j] = t


@kernel(parallel=True)
def regress(
    points, triangles, use, x0, y0, p, owner, sigma_f, length_scale, sigma_eps, mean, variance, seen
):  # fmt: skip
    """Write mean and variance (Eqs. 4 to 6) of every owned cell from its triangle's vertices.

    The prior mean is that of the three vertices. Triangles with use False (they span a gap)
    give the prior variance and leave `seen` False.
    """
    rows, cols = owner.shape
    prior = sigma_f * sigma_f
    noise = sigma_eps * sigma_eps
    for i in prange(rows):
        gram = np.empty((3, 3))
        inverse = np.empty((3, 3))
        k = np.empty(3)
        alpha = np.zeros(3)
        last = -1
        base = 0.0
        y = y0 + p * i
        for j in range(cols):
            t = owner[i, j]
            if t < 0:
                continue
            if t != last:
                base = 0.0
                for a in range(3):
                    base += points[triangles[t, a], 2] / 3.0
                    for b in range(3):
                        d = np.hypot(
                            points[triangles[t, a], 0] - points[triangles[t, b], 0],
                            points[triangles[t, a], 1] - points[triangles[t, b], 1],
                        )
                        gram[a, b] = prior * np.exp(-d / length_scale)
                    gram[a, a] = prior + noise
                _invert3(gram, inverse)
                for a in range(3):
                    alpha[a] = 0.0
                    for b in range(3):
                        alpha[a] += inverse[a, b] * (points[triangles[t, b], 2] - base)
                last = t
            x = x0 + p * j
            value = base
            for a in range(3):
                d = np.hypot(points[triangles[t, a], 0] - x, points[triangles[t, a], 1] - y)
                k[a] = prior * np.exp(-d / length_scale)
                value += k[a] * alpha[a]
            explained = 0.0
            for a in range(3):
                for b in range(3):
                    explained += k[a] * inverse[a, b] * k[b]
            mean[i, j] = value
            if use[t]:
                variance[i, j] = max(prior - explained, 0.0)
                seen[i, j] = True
            else:
                variance[i, j] = prior
