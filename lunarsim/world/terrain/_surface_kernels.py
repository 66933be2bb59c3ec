# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled terrain queries at points.

The relief is a grid of elevations `z` (rows, cols) whose point (0, 0) lies at (x0, y0). Squares of
`bucket_cells` x `bucket_cells` cells are buckets: each lists the rocks whose outline touches it
(`start`, `index`, in compressed rows). Rows of rock parameters are those of
`lunarsim.rocks._kernels`.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.rocks._kernels import rock_height, rock_normal


@kernel()
def relief_at(x, y, z, x0, y0, p):
    """Return the elevation, m, of the triangulated relief at (x, y); NaN outside.

    `z` (rows, cols) are its elevations, (x0, y0) its first point and `p` its spacing, m.
    """
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
def _top_rock(x, y, x0, y0, p, bucket_cells, rocks, planes, count, start, index, cols):
    """Return elevation and index of the highest rock at (x, y); (-inf, -1): no rock.

    The first grid point is (x0, y0), the spacing `p`; buckets have `bucket_cells` cells along a
    side. The rocks are `rocks` (n, 9), their shapes `planes` and `count`, and the bucket lists
    `start` and `index`; `cols` is the number of columns of the relief.
    """
    best = -np.inf
    which = -1
    width = (cols - 2) // bucket_cells + 1
    j = min(int((x - x0) / p), cols - 2) // bucket_cells
    i = int((y - y0) / p) // bucket_cells
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
def _surface(x, y, z, x0, y0, p, bucket_cells, rocks, planes, count, start, index):
    terrain_height = relief_at(x, y, z, x0, y0, p)
    if np.isnan(terrain_height) or rocks.shape[0] == 0:
        return terrain_height
    top, _ = _top_rock(
        x, y, x0, y0, p, bucket_cells, rocks, planes, count, start, index, z.shape[1]
    )
    return max(terrain_height, top)


@kernel()
def elevation_at(xy, z, x0, y0, p, bucket_cells, rocks, planes, count, start, index):
    """Return the elevation (n,), m, of relief and rocks at points `xy` (n, 2).

    The relief is `z` with the first point (x0, y0) and the spacing `p`; `bucket_cells`, `rocks`,
    `planes`, `count`, `start` and `index` are those of `_top_rock`.
    """
    out = np.empty(xy.shape[0])
    for i in range(xy.shape[0]):
        out[i] = _surface(
            xy[i, 0], xy[i, 1], z, x0, y0, p, bucket_cells, rocks, planes, count, start, index
        )
    return out


@kernel(shared=True, allocates=False)
def raster(thread_slice, gx, gy, gp, z, x0, y0, p, rocks, planes, count, reach, out):
    """Write the elevation of relief and rocks at the cell centres of another grid.

    `out` (rows, cols), float32, m, has its first centre at (gx, gy) and the spacing `gp`; `reach`
    (n,), m, are radii about the rocks' centres that contain their outlines; `thread_slice` is
    (thread, number of threads). The other arguments are those of `elevation_at`.
    """
    rows, cols = out.shape
    thread, threads = thread_slice
    for i in range(thread, rows, threads):
        y = gy + gp * i
        for j in range(cols):
            out[i, j] = relief_at(gx + gp * j, y, z, x0, y0, p)
    for n in range(len(rocks)):
        east, north = (rocks[n, 0] - gx) / gp, (rocks[n, 1] - gy) / gp
        cells = reach[n] / gp + 1e-6
        left, right = max(int(np.ceil(east - cells)), 0), min(int(east + cells), cols - 1)
        bottom, top = max(int(np.ceil(north - cells)), 0), min(int(north + cells), rows - 1)
        if left > right or bottom > top:
            continue
        for i in range(bottom + (thread - bottom) % threads, top + 1, threads):
            y = gy + gp * i
            for j in range(left, right + 1):
                height = np.float32(rock_height(gx + gp * j, y, rocks, n, planes, count))
                # False where the relief is unknown.
                out[i, j] = max(out[i, j], height)


@kernel()
def relief_normal(x, y, z, x0, y0, p, out):
    """Write the unit normal (3,) of the relief triangle at (x, y) into `out`.

    `z` (rows, cols) are the elevations, (x0, y0) the first grid point and `p` the spacing, m.
    """
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
def normal_at(xy, z, x0, y0, p, bucket_cells, rocks, planes, count, start, index):
    """Return the unit normal (n, 3) of relief and rocks at points `xy` (n, 2).

    The arguments are those of `elevation_at`; the normal is NaN where the relief is unknown.
    """
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
                x, y, x0, y0, p, bucket_cells, rocks, planes, count, start, index, z.shape[1]
            )
        if top > terrain_height:
            rock_normal(x, y, top, rocks, n, planes, count, out[i])
        else:
            relief_normal(x, y, z, x0, y0, p, out[i])
    return out


@kernel(shared=True, allocates=False)
def rock_raster(
    thread_slice, gx, gy, gp, z, x0, y0, p, bucket_cells, rocks, planes, count, start, index, out
):
    """Write the index of the top rock at the cell centres of another grid.

    `out` (rows, cols) has its first centre at (gx, gy) and the spacing `gp`; cells without a rock
    remain unchanged. `thread_slice` is (thread, number of threads). The other arguments are those
    of `elevation_at`.
    """
    rows, cols = out.shape
    for i in range(thread_slice[0], rows, thread_slice[1]):
        y = gy + gp * i
        for j in range(cols):
            x = gx + gp * j
            terrain_height = relief_at(x, y, z, x0, y0, p)
            if rocks.shape[0] > 0 and not np.isnan(terrain_height):
                top, n = _top_rock(
                    x, y, x0, y0, p, bucket_cells, rocks, planes, count, start, index, z.shape[1]
                )
                if top > terrain_height:
                    out[i, j] = n
