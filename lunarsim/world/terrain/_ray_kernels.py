# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled ray casting over relief and rocks.

The relief has a pyramid of maxima (Tevs, Ihrke and Seidel 2008): level 0 holds the highest point of
each cell, level l that of 2^l x 2^l cells. All levels lie in one flat array `peak`; level l starts
at `offset[l]` and has `level_rows[l]` x `level_cols[l]` nodes. From the level of the buckets
(`base`) upward the maxima include the rocks; `terrain_peak` holds the maxima of the buckets without
them. Each bucket lists its rocks (`start`, `index`, in compressed rows).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.rocks._kernels import rock_hit, rock_normal
from lunarsim.world.terrain._surface_kernels import relief_normal


class Pyramid(NamedTuple):
    """Pyramid of surface maxima over squares of 2^l x 2^l cells at level l.

    Attributes
    ----------
    base
        Level whose squares are the buckets that list the rocks.
    peak
        Maximum elevation in each square of each level, m; with rocks from level `base` upward.
    terrain_peak
        Maximum elevation in each bucket without rocks, m.
    offset, level_rows, level_cols
        First index in `peak`, and numbers of rows and columns, of each level.
    """

    base: Any  # level of the buckets
    peak: Any
    terrain_peak: Any
    offset: Any
    level_rows: Any
    level_cols: Any


class Rocks(NamedTuple):
    """Rocks, their shapes, and the list of rocks in each bucket (square of cells).

    Attributes
    ----------
    rows
        Rocks (n, 9): x, y, base, half axes a and b, height, cos and sin of the yaw, shape.
    planes, count
        Half spaces of each unit shape, and their number.
    start, index
        Bucket k contains the rocks `index[start[k]:start[k + 1]]`.
    """

    rows: Any  # (n, 9)
    planes: Any
    count: Any
    start: Any
    index: Any


class _Ray(NamedTuple):
    """A ray in metres, ENU, and in units of the grid spacing.

    The ray starts at (ox, oy, oz) in the direction (dx, dy, dz). In grid units it starts at (u, v)
    and moves by (du, dv) per metre. The inverses (nu, nv, nz) of du, dv and dz convert grid
    units and heights to distances along the ray.
    """

    ox: Any
    oy: Any
    oz: Any
    dx: Any
    dy: Any
    dz: Any
    u: Any
    v: Any
    du: Any
    dv: Any
    nu: Any
    nv: Any
    nz: Any


@kernel()
def list_rocks(rocks, reach, x0, y0, side, bucket_rows, bucket_cols):
    """List the rocks that touch each bucket, a square of `side` metres.

    `rocks` (n, 9) are the rocks and `reach` (n,) the radii of their outlines, m. There are
    `bucket_rows` x `bucket_cols` buckets from the corner (x0, y0). Bucket k lists
    `index[start[k]:start[k + 1]]`; `start` and `index` are returned.
    """
    start = np.zeros(bucket_rows * bucket_cols + 1, np.int64)
    index = np.empty(0, np.int64)
    for fill in range(2):
        if fill == 1:
            for bucket in range(bucket_rows * bucket_cols):
                start[bucket + 1] += start[bucket]
            index = np.empty(start[-1], np.int64)
            for bucket in range(bucket_rows * bucket_cols, 0, -1):
                start[bucket] = start[bucket - 1]
            start[0] = 0
        for n in range(rocks.shape[0]):
            j0 = max(int(np.floor((rocks[n, 0] - reach[n] - x0) / side)), 0)
            j1 = min(int(np.floor((rocks[n, 0] + reach[n] - x0) / side)), bucket_cols - 1)
            i0 = max(int(np.floor((rocks[n, 1] - reach[n] - y0) / side)), 0)
            i1 = min(int(np.floor((rocks[n, 1] + reach[n] - y0) / side)), bucket_rows - 1)
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    bucket = i * bucket_cols + j
                    if fill == 1:
                        index[start[bucket + 1]] = n
                    start[bucket + 1] += 1
    return start, index


@kernel()
def build_pyramid(z, rocks, start, index, base, offset, level_rows, level_cols):
    """Compute the surface maxima `peak` and `terrain_peak` of a `Pyramid`.

    `z` (rows, cols) are elevations, m; `rocks` (n, 9), `start` and `index` the rocks and their
    bucket lists; `base`, `offset`, `level_rows` and `level_cols` the layout of the levels.
    """
    peak = np.empty(offset[-1] + level_rows[-1] * level_cols[-1], np.float32)
    lowest = np.float32(-np.inf)
    for i in range(level_rows[0]):
        for j in range(level_cols[0]):
            best = lowest
            # A comparison with NaN is false, so that no-data is ignored.
            for r in range(2):
                for c in range(2):
                    best = max(best, z[i + r, j + c])
            peak[i * level_cols[0] + j] = best
    terrain_peak = peak[: level_rows[0] * level_cols[0]].copy()
    for level in range(offset.size):
        if level > 0:
            below = level - 1
            for i in range(level_rows[level]):
                for j in range(level_cols[level]):
                    best = lowest
                    for r in range(2 * i, min(2 * i + 2, level_rows[below])):
                        for c in range(2 * j, min(2 * j + 2, level_cols[below])):
                            best = max(best, peak[offset[below] + r * level_cols[below] + c])
                    peak[offset[level] + i * level_cols[level] + j] = best
        if level == base:
            here = offset[level]
            terrain_peak = peak[here : here + level_rows[level] * level_cols[level]].copy()
            for bucket in range(level_rows[level] * level_cols[level]):
                for m in range(start[bucket], start[bucket + 1]):
                    n = index[m]
                    # Rounded up: the bucket's maximum must never be below the rock's top.
                    top = np.float32(rocks[n, 2] + rocks[n, 5])
                    top = np.nextafter(top, np.float32(np.inf))
                    peak[here + bucket] = max(peak[here + bucket], top)
    return peak, terrain_peak


@kernel(inline=True)
def _cell_hit(ray, z, i, j, t0, t1):
    """Return the distance, m, at which a ray hits the two triangles of cell (i, j).

    The ray is in the cell from distance t0 to t1. The result is inf for no hit and -1 for a ray
    that enters the cell below the surface. Each triangle is a plane, so that the height of the ray
    above it is linear in the distance; the path in the cell is split at the diagonal.
    """
    z00 = np.float64(z[i, j])
    z10 = np.float64(z[i, j + 1])
    z01 = np.float64(z[i + 1, j])
    z11 = np.float64(z[i + 1, j + 1])
    h = ray.oz
    dz = ray.dz
    u0 = ray.u + t0 * ray.du - j
    v0 = ray.v + t0 * ray.dv - i
    u1 = ray.u + t1 * ray.du - j
    v1 = ray.v + t1 * ray.dv - i
    if u0 >= v0:
        above0 = h + t0 * dz - (z00 + u0 * (z10 - z00) + v0 * (z11 - z10))
    else:
        above0 = h + t0 * dz - (z00 + v0 * (z01 - z00) + u0 * (z11 - z01))
    if u1 >= v1:
        above1 = h + t1 * dz - (z00 + u1 * (z10 - z00) + v1 * (z11 - z10))
    else:
        above1 = h + t1 * dz - (z00 + v1 * (z01 - z00) + u1 * (z11 - z01))
    if above0 < -1e-6:  # entered from below, through no-data or the edge of the map
        return -1.0
    if (u0 >= v0) != (u1 >= v1):
        s0 = u0 - v0
        w = s0 / (s0 - (u1 - v1))
        tm = t0 + w * (t1 - t0)
        um = u0 + w * (u1 - u0)
        middle = h + tm * dz - (z00 + um * (z11 - z00))
        if middle > 0.0:
            above0 = middle
            t0 = tm
        elif middle <= 0.0:
            above1 = middle
            t1 = tm
    if above1 > 0.0 or np.isnan(above1) or np.isnan(above0):
        return np.inf
    # Rounding may put a point on the surface slightly below it: still a hit.
    if above0 > above1:
        return t0 + (t1 - t0) * max(above0, 0.0) / (above0 - above1)
    return t0


@kernel(inline=True)
def _try_rocks(ray, t, bucket, nearest_distance, nearest_rock, rocks):
    """Find the nearest hit of a ray on the rocks of a bucket, at distance t or more.

    `nearest_distance`, m, and `nearest_rock` (an index) are the nearest hit so far. They are
    returned unchanged if no rock of the bucket is hit nearer, otherwise with their new values.
    """
    for m in range(rocks.start[bucket], rocks.start[bucket + 1]):
        n = rocks.index[m]
        hit = rock_hit(
            ray.ox, ray.oy, ray.oz, ray.dx, ray.dy, ray.dz, rocks.rows, n, rocks.planes, rocks.count
        )
        # A hit beyond this bucket is also valid.
        if hit >= t - 1e-9 and hit < nearest_distance:
            nearest_distance = hit
            nearest_rock = n
    return nearest_distance, nearest_rock


@kernel(inline=True)
def _exit_distances(ray, i, j, level):
    """Return the distances along a ray to the two sides where it can leave a square.

    The square (i, j) belongs to a level of the pyramid. The first distance is to its east or west
    side, the second to its north or south side, m; inf for a side parallel to the ray.
    """
    wu = 1 if ray.dx > 0.0 else 0
    wv = 1 if ray.dy > 0.0 else 0
    tu = (((j + wu) << level) - ray.u) * ray.nu if ray.du != 0.0 else np.inf
    tv = (((i + wv) << level) - ray.v) * ray.nv if ray.dv != 0.0 else np.inf
    return tu, tv


@kernel(inline=True)
def _descend_to(ray, level, t, t1, i, j, rows, cols):
    """Advance a ray from distance t down to the elevation `level`.

    Returns the new distance and its cell (i, j), of a grid of `rows` x `cols`. If the ray is
    already below `level`, t, i and j are returned unchanged. Beyond the end t1 of the ray, the cell
    is (-1, -1).
    """
    below = (np.float64(level) - ray.oz) * ray.nz
    if below > t:
        t = below
        j = min(int(ray.u + t * ray.du), cols - 2) if t <= t1 else -1
        i = min(int(ray.v + t * ray.dv), rows - 2) if t <= t1 else -1
    return t, i, j


@kernel(inline=True)
def _walk_cells(ray, z, base, t, t1, i, j):
    """Follow a ray from cell to cell until it hits the relief or leaves its bucket.

    The ray starts at distance t in cell (i, j) and ends at t1. `z` are the elevations; a bucket has
    2^base cells along a side. Returns the result of the last `_cell_hit`, and the distance and cell
    where the walk ends. This distance is t1 or more at the end of the ray, and inf off the map.
    """
    rows, cols = z.shape
    su = 1 if ray.dx > 0.0 else -1
    sv = 1 if ray.dy > 0.0 else -1
    bucket_i = i >> base
    bucket_j = j >> base
    while True:
        tu, tv = _exit_distances(ray, i, j, 0)
        out = max(min(min(tu, tv), t1), t)
        hit = _cell_hit(ray, z, i, j, t, out)
        if hit < np.inf:
            return hit, t, i, j
        t = out
        if t >= t1:
            return np.inf, t, i, j
        if tu <= tv:
            j += su
        else:
            i += sv
        if j < 0 or j > cols - 2 or i < 0 or i > rows - 2:
            return np.inf, np.inf, i, j
        if (j >> base) != bucket_j or (i >> base) != bucket_i:
            return np.inf, t, i, j


@kernel(inline=True)
def _nearest_hit(relief_distance, t, rock_distance, rock_index):
    """Return the nearer of a relief hit and a rock hit: distance and rock index.

    A `relief_distance` of -1 means that the ray is below the surface at t: only a rock hit before t
    counts. The returned index is -1 for relief and -2 for no hit.
    """
    if relief_distance < 0.0:
        return (rock_distance, rock_index) if rock_distance <= t else (np.inf, -2)
    return (relief_distance, -1) if relief_distance < rock_distance else (rock_distance, rock_index)


@kernel(inline=True)
def _steep_hit(ray, t, t1, z, pyramid, rocks):
    """Return distance and rock of the first hit of a steeply descending ray.

    The ray is on the map from distance t to t1. `z` are the elevations, `pyramid` their maxima and
    `rocks` the rocks. The returned rock index is -1 for relief and -2 for no hit.
    The hit lies within a few cells of the point where the ray descends below a bucket's maximum;
    the search walks from there from cell to cell.
    """
    rows, cols = z.shape
    base = pyramid.base
    width = pyramid.level_cols[base]
    height = pyramid.level_rows[base]
    start_of_peaks = pyramid.offset[base]
    best = np.inf
    which = -2
    cj = min(max(int(ray.u + t * ray.du), 0), cols - 2)
    ci = min(max(int(ray.v + t * ray.dv), 0), rows - 2)
    j = cj >> base
    i = ci >> base
    while True:
        bucket = i * width + j
        t, ci, cj = _descend_to(
            ray, pyramid.peak[start_of_peaks + bucket], t, t1, ci, cj, rows, cols
        )
        # Whether the ray descends below the bucket's maximum before it leaves the bucket.
        inside = (cj >> base) == j and (ci >> base) == i
        if inside and rocks.start[bucket] < rocks.start[bucket + 1]:
            best, which = _try_rocks(ray, t, bucket, best, which, rocks)
            t1 = min(t1, best)
            t, ci, cj = _descend_to(ray, pyramid.terrain_peak[bucket], t, t1, ci, cj, rows, cols)
            inside = (cj >> base) == j and (ci >> base) == i
        if inside:
            hit, t, ci, cj = _walk_cells(ray, z, base, t, t1, ci, cj)
            if hit < np.inf:
                return _nearest_hit(hit, t, best, which)
            if t >= t1:
                return best, which
            j = cj >> base
            i = ci >> base
            continue
        # The ray passes above the bucket: leave it through its nearer side.
        tu, tv = _exit_distances(ray, i, j, base)
        t = min(tu, tv)
        if t >= t1:
            return best, which
        if tu <= tv:
            j += 1 if ray.dx > 0.0 else -1
        else:
            i += 1 if ray.dy > 0.0 else -1
        if j < 0 or j >= width or i < 0 or i >= height:
            return best, which
        cj = min(max(int(ray.u + t * ray.du), j << base), min((j + 1) << base, cols - 1) - 1)
        ci = min(max(int(ray.v + t * ray.dv), i << base), min((i + 1) << base, rows - 1) - 1)


@kernel(inline=True)
def _levels_up(before, after, level, base, top_level):
    """Return the number of pyramid levels to ascend after a step to the next square.

    `before` and `after` are the square's row or column, `level` its level, `base` the level of the
    buckets that list the rocks, and `top_level` the coarsest level. The number is 0 if both squares
    have the same parent.
    """
    # A step out of a bucket must enter the next one at the level of its list of rocks.
    shift = max(base - level, 1)
    if (before >> shift) != (after >> shift):
        return min(shift, top_level - level)
    return 1 if (before >> 1) != (after >> 1) else 0


@kernel(inline=True)
def _grazing_hit(ray, t, t1, z, pyramid, rocks):
    """Return distance and rock of the first hit of a grazing or ascending ray.

    The ray is on the map from distance t to t1. The rock is -1 for relief and -2 for no hit. The
    search traverses the pyramid: it skips squares below the ray and descends one level in the
    others. At the level of the buckets it tests the rocks, at level 0 the two triangles of the
    cell.
    """
    rows, cols = z.shape
    base, _, _, _, level_rows, level_cols = pyramid
    last = pyramid.offset.size - 1
    down = ray.dz < 0.0
    level = base
    j = min(max(int(ray.u + t * ray.du), 0), cols - 2) >> level
    i = min(max(int(ray.v + t * ray.dv), 0), rows - 2) >> level
    best = np.inf
    which = -2
    while True:
        tu, tv = _exit_distances(ray, i, j, level)
        leave = max(min(min(tu, tv), t1), t)
        bucket = i * level_cols[level] + j
        top = np.float64(pyramid.peak[pyramid.offset[level] + bucket])
        inside = ray.oz + (leave if down else t) * ray.dz <= top
        if inside and down:
            t = min(max(t, (top - ray.oz) * ray.nz), leave)
        if inside and level == base and rocks.start[bucket] < rocks.start[bucket + 1]:
            best, which = _try_rocks(ray, t, bucket, best, which, rocks)
            t1 = min(t1, best)
            bare = np.float64(pyramid.terrain_peak[bucket])
            leave = max(min(leave, t1), t)
            inside = ray.oz + (leave if down else t) * ray.dz <= bare
            if inside and down:
                t = min(max(t, (bare - ray.oz) * ray.nz), leave)
        if inside and level > 0:
            level -= 1
            j = min(
                max(int(ray.u + t * ray.du) >> level, 2 * j), min(2 * j + 1, level_cols[level] - 1)
            )
            i = min(
                max(int(ray.v + t * ray.dv) >> level, 2 * i), min(2 * i + 1, level_rows[level] - 1)
            )
            continue
        if inside:
            hit = _cell_hit(ray, z, i, j, t, leave)
            if hit < np.inf:
                return _nearest_hit(hit, t, best, which)
        t = leave
        if t >= t1:
            return best, which
        if tu <= tv:
            here = j
            j += 1 if ray.dx > 0.0 else -1
            there = j
        else:
            here = i
            i += 1 if ray.dy > 0.0 else -1
            there = i
        if there < 0 or there >= (level_cols[level] if tu <= tv else level_rows[level]):
            return best, which
        rise = _levels_up(here, there, level, base, last)
        level += rise
        j >>= rise
        i >>= rise


@kernel(inline=True)
def _ray_in_grid_units(ox, oy, oz, dx, dy, dz, x0, y0, p):
    """Return a ray in the grid units of a relief.

    The ray starts at (ox, oy, oz) in the direction (dx, dy, dz), m, ENU. The first grid point of
    the relief is (x0, y0) and its spacing is p, m.
    """
    q = 1.0 / p
    du = dx * q
    dv = dy * q
    # Finite, because an infinite inverse would turn 0 * inf into NaN.
    nu = 1.0 / du if abs(du) > 1e-200 else 1e200
    nv = 1.0 / dv if abs(dv) > 1e-200 else 1e200
    nz = 1.0 / dz if abs(dz) > 1e-200 else 1e200
    return _Ray(ox, oy, oz, dx, dy, dz, (ox - x0) * q, (oy - y0) * q, du, dv, nu, nv, nz)


@kernel(inline=True)
def _first_hit(ray, max_range, z, pyramid, rocks):
    """Return distance, m, and rock index of a ray's first hit (-1 relief, -2 no hit).

    `max_range` is the maximum range, m, `z` are the elevations, `pyramid` their maxima and `rocks`
    the rocks.

    A ray that starts below the surface hits nothing.
    """
    rows, cols = z.shape
    ta = -ray.u * ray.nu
    tb = (cols - 1 - ray.u) * ray.nu
    tc = -ray.v * ray.nv
    td = (rows - 1 - ray.v) * ray.nv
    t = max(max(0.0, min(ta, tb)), min(tc, td))
    t1 = min(min(max_range, max(ta, tb)), max(tc, td))
    summit = np.float64(pyramid.peak[pyramid.offset[pyramid.offset.size - 1]])
    if ray.oz + t * ray.dz > summit:
        if ray.dz >= 0.0:
            return np.inf, -2
        t = max(t, (summit - ray.oz) * ray.nz)
    if not t <= t1:
        return np.inf, -2
    if ray.dz < -0.3:
        return _steep_hit(ray, t, t1, z, pyramid, rocks)
    return _grazing_hit(ray, t, t1, z, pyramid, rocks)


@kernel(shared=True, allocates=False)
def cast(
    thread_slice, origin, direction, max_range, normals, z, frame,
    base, peak, terrain_peak, offset, level_rows, level_cols,
    rows, planes, count, start, index, hits,
):  # fmt: skip
    """Intersect rays with relief and rocks; write the first hits into `hits`.

    `origin` (1 or n, 3) and `direction` (n, 3) are the rays, ENU, and `max_range` is the maximum
    range, m. `hits` are three arrays: distance (n,), normal (n, 3; not written without `normals`)
    and rock index (n,). The index is -1 for relief and -2 for a miss; distance and normal of a miss
    are NaN. `z` are the elevations and `frame` (x0, y0, spacing) their grid; `thread_slice` is
    (thread, number of threads). The fields of `Pyramid` and `Rocks` are passed one by one:
    unpacking a tuple at every call would make single rays 25 % slower.
    """
    rays = direction.shape[0]
    x0, y0, p = frame
    distance, normal, rock = hits
    each = 1 if origin.shape[0] > 1 else 0
    pyramid = Pyramid(base, peak, terrain_peak, offset, level_rows, level_cols)
    rocks = Rocks(rows, planes, count, start, index)
    for n in range(thread_slice[0], rays, thread_slice[1]):
        ox = origin[n * each, 0]
        oy = origin[n * each, 1]
        oz = origin[n * each, 2]
        dx = direction[n, 0]
        dy = direction[n, 1]
        dz = direction[n, 2]
        ray = _ray_in_grid_units(ox, oy, oz, dx, dy, dz, x0, y0, p)
        best, which = _first_hit(ray, max_range, z, pyramid, rocks)
        rock[n] = which
        distance[n] = np.nan if which == -2 else best
        if normals:
            hx = ox + best * dx
            hy = oy + best * dy
            if which >= 0:
                hz = oz + best * dz
                rock_normal(hx, hy, hz, rocks.rows, which, rocks.planes, rocks.count, normal[n])
            elif which == -1:
                relief_normal(hx, hy, z, x0, y0, p, normal[n])
            else:
                normal[n, :] = np.nan
