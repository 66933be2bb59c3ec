# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled terrain queries at points.

The relief is a grid of posts `z` (rows, cols) whose post (0, 0) lies at (x0, y0). Squares of
`leaf` x `leaf` cells are buckets: each lists the rocks whose outline touches it (`start`,
`index`, in compressed rows). Rows of rock parameters are those of `lunarsim.rocks._kernels`.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.rocks._kernels import rock_height, rock_normal


@kernel()
def relief_at(x, y, z, x0, y0, p):
    """Return the elevation of the triangulated relief; NaN outside."""
    u = (x - x0) / p
    v = (y - y0) / p
    rows, cols = z.shape
    result = np.nan
    # Written so that NaN coordinates fail the test.
    if u >= 0.0 and v >= 0.0 and u <= cols - 1 and v <= rows - 1:
        j = min(int(u), cols - 2)
        i = min(int(v), rows - 2)
        u -= j
        v -= i
        z00 = np.float64(z[i, j])
        z11 = np.float64(z[i + 1, j + 1])
        if u >= v:
            z10 = np.float64(z[i, j + 1])
            result = z00 + u * (z10 - z00) + v * (z11 - z10)
        else:
            z01 = np.float64(z[i + 1, j])
            result = z00 + v * (z01 - z00) + u * (z11 - z01)
    return result


@kernel()
def _top_rock(x, y, x0, y0, p, leaf, rocks, planes, count, start, index, cols):
    """Return the elevation and index of the highest rock at (x, y), or (-inf, -1)."""
    best = -np.inf
    which = -1
    width = (cols - 2) // leaf + 1
    j = min(int((x - x0) / p), cols - 2) // leaf
    i = int((y - y0) / p) // leaf
    height = (start.size - 1) // width
    if i >= height:
        i = height - 1
    bucket = i * width + j
    for m in range(start[bucket], start[bucket + 1]):
        n = index[m]
        top = rock_height(x, y, rocks, n, planes, count)
        if top > best:
            best = top
            which = n
    return best, which


@kernel()
def _surface(x, y, z, x0, y0, p, leaf, rocks, planes, count, start, index):
    terrain_height = relief_at(x, y, z, x0, y0, p)
    if np.isnan(terrain_height) or rocks.shape[0] == 0:
        return terrain_height
    top, _ = _top_rock(x, y, x0, y0, p, leaf, rocks, planes, count, start, index, z.shape[1])
    return max(terrain_height, top)


@kernel()
def elevation_at(xy, z, x0, y0, p, leaf, rocks, planes, count, start, index):
    """Return the surface elevation (n,) at points (n, 2)."""
    out = np.empty(xy.shape[0])
    for i in range(xy.shape[0]):
        out[i] = _surface(
            xy[i, 0], xy[i, 1], z, x0, y0, p, leaf, rocks, planes, count, start, index
        )
    return out


@kernel(shared=True, allocates=False)
def raster(share, gx, gy, gp, z, x0, y0, p, leaf, rocks, planes, count, start, index, out):
    """Write the surface elevation at the cell centres of a grid (rows, cols), float32."""
    rows, cols = out.shape
    for i in range(share[0], rows, share[1]):
        y = gy + gp * i
        for j in range(cols):
            out[i, j] = _surface(
                gx + gp * j, y, z, x0, y0, p, leaf, rocks, planes, count, start, index
            )


@kernel()
def relief_normal(x, y, z, x0, y0, p, out):
    """Write the unit normal of the relief triangle at (x, y), inside the grid."""
    rows, cols = z.shape
    u = (x - x0) / p
    v = (y - y0) / p
    j = min(max(int(u), 0), cols - 2)
    i = min(max(int(v), 0), rows - 2)
    z00 = np.float64(z[i, j])
    z11 = np.float64(z[i + 1, j + 1])
    if u - j >= v - i:
        z10 = np.float64(z[i, j + 1])
        gx = (z10 - z00) / p
        gy = (z11 - z10) / p
    else:
        z01 = np.float64(z[i + 1, j])
        gx = (z11 - z01) / p
        gy = (z01 - z00) / p
    norm = np.sqrt(1.0 + gx * gx + gy * gy)
    out[0] = -gx / norm
    out[1] = -gy / norm
    out[2] = 1.0 / norm


@kernel()
def normal_at(xy, z, x0, y0, p, leaf, rocks, planes, count, start, index):
    """Return the unit surface normal (n, 3) at points (n, 2)."""
    out = np.full((xy.shape[0], 3), np.nan)
    for i in range(xy.shape[0]):
        x = xy[i, 0]
        y = xy[i, 1]
        terrain_height = relief_at(x, y, z, x0, y0, p)
        if np.isnan(terrain_height):
            continue
        top = -np.inf
        n = -1
        if rocks.shape[0] > 0:
            top, n = _top_rock(
                x, y, x0, y0, p, leaf, rocks, planes, count, start, index, z.shape[1]
            )
        if top > terrain_height:
            rock_normal(x, y, top, rocks, n, planes, count, out[i])
        else:
            relief_normal(x, y, z, x0, y0, p, out[i])
    return out


@kernel(shared=True, allocates=False)
def rock_raster(share, gx, gy, gp, z, x0, y0, p, leaf, rocks, planes, count, start, index, out):
    """Write the index of the rock on top at the cell centres of a grid that have one."""
    rows, cols = out.shape
    for i in range(share[0], rows, share[1]):
        y = gy + gp * i
        for j in range(cols):
            x = gx + gp * j
            terrain_height = relief_at(x, y, z, x0, y0, p)
            if rocks.shape[0] > 0 and not np.isnan(terrain_height):
                top, n = _top_rock(
                    x, y, x0, y0, p, leaf, rocks, planes, count, start, index, z.shape[1]
                )
                if top > terrain_height:
                    out[i, j] = n
