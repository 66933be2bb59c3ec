"""Compiled ray casting over relief and rocks.

The relief carries a pyramid of maxima (Tevs, Ihrke and Seidel 2008): level 0 holds the highest
post of each cell, level l that of 2^l x 2^l cells. All levels lie in one flat array `peak`; level l
starts at `offset[l]` and is `high[l]` x `wide[l]`. From the level of the buckets (`base`) upward
the maxima include the rocks; `ground` holds those of the buckets without them. Buckets list their
rocks (`start`, `index`, in compressed rows).
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.rocks._kernels import rock_hit, rock_normal
from lunarsim.world.terrain._surface_kernels import relief_normal


@kernel()
def list_rocks(rocks, reach, x0, y0, side, high, wide):
    """Return the rocks (start, index) that touch each bucket of `side` metres."""
    start = np.zeros(high * wide + 1, np.int64)
    index = np.empty(0, np.int64)
    for fill in range(2):
        if fill == 1:
            for bucket in range(high * wide):
                start[bucket + 1] += start[bucket]
            index = np.empty(start[-1], np.int64)
            start[1:] = start[:-1].copy()
            start[0] = 0
        for n in range(rocks.shape[0]):
            j0 = max(int(np.floor((rocks[n, 0] - reach[n] - x0) / side)), 0)
            j1 = min(int(np.floor((rocks[n, 0] + reach[n] - x0) / side)), wide - 1)
            i0 = max(int(np.floor((rocks[n, 1] - reach[n] - y0) / side)), 0)
            i1 = min(int(np.floor((rocks[n, 1] + reach[n] - y0) / side)), high - 1)
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    bucket = i * wide + j
                    if fill == 1:
                        index[start[bucket + 1]] = n
                    start[bucket + 1] += 1
    return start, index


@kernel(parallel=True)
def build_pyramid(z, rocks, start, index, base, offset, high, wide):
    """Return the pyramid of maxima `peak` and the buckets' maxima without rocks, `ground`."""
    peak = np.empty(offset[-1] + high[-1] * wide[-1], np.float32)
    least = np.float32(-np.inf)
    for i in prange(high[0]):
        for j in range(wide[0]):
            best = least
            # A comparison with NaN is false, so no-data never wins.
            for r in range(2):
                for c in range(2):
                    best = max(best, z[i + r, j + c])
            peak[i * wide[0] + j] = best
    ground = peak[: high[0] * wide[0]].copy()
    for level in range(offset.size):
        if level > 0:
            below = level - 1
            for i in prange(high[level]):
                for j in range(wide[level]):
                    best = least
                    for r in range(2 * i, min(2 * i + 2, high[below])):
                        for c in range(2 * j, min(2 * j + 2, wide[below])):
                            best = max(best, peak[offset[below] + r * wide[below] + c])
                    peak[offset[level] + i * wide[level] + j] = best
        if level == base:
            here = offset[level]
            ground = peak[here : here + high[level] * wide[level]].copy()
            for bucket in prange(high[level] * wide[level]):
                for m in range(start[bucket], start[bucket + 1]):
                    n = index[m]
                    # Rounded up: the bucket's top must never be below the rock's.
                    top = np.float32(rocks[n, 2] + rocks[n, 5])
                    top = np.nextafter(top, np.float32(np.inf))
                    peak[here + bucket] = max(peak[here + bucket], top)
    return peak, ground


@kernel(inline=True)
def _cell_hit(z, i, j, u, v, h, du, dv, dz, t0, t1):
    """Return the distance at which a ray meets the two triangles of cell (i, j).

    The answer is inf for none and -1 for a ray that enters the cell underground. The ray starts
    at (u, v) in posts and h in metres, and moves by (du, dv, dz) a metre; it is in the cell from
    t0 to t1.

    Within a triangle the surface is a plane, so the height of the ray above it is linear in
    the distance. The ray's stay in the cell is cut at the diagonal.
    """
    z00 = np.float64(z[i, j])
    z10 = np.float64(z[i, j + 1])
    z01 = np.float64(z[i + 1, j])
    z11 = np.float64(z[i + 1, j + 1])
    u0 = u + t0 * du - j
    v0 = v + t0 * dv - i
    u1 = u + t1 * du - j
    v1 = v + t1 * dv - i
    if u0 >= v0:
        above0 = h + t0 * dz - (z00 + u0 * (z10 - z00) + v0 * (z11 - z10))
    else:
        above0 = h + t0 * dz - (z00 + v0 * (z01 - z00) + u0 * (z11 - z01))
    if u1 >= v1:
        above1 = h + t1 * dz - (z00 + u1 * (z10 - z00) + v1 * (z11 - z10))
    else:
        above1 = h + t1 * dz - (z00 + v1 * (z01 - z00) + u1 * (z11 - z01))
    if above0 < -1e-6:  # came in from below, past no-data or the edge of the map
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
    # Rounding may put a point on the ground a hair below it: still a hit.
    if above0 > above1:
        return t0 + (t1 - t0) * max(above0, 0.0) / (above0 - above1)
    return t0


@kernel(inline=True)
def _try_rocks(
    ox, oy, oz, dx, dy, dz, t, bucket, best, which, rocks, planes, count, start, index
):  # fmt: skip
    """Return the nearest hit at or after t of the bucket's rocks, and the rock."""
    for m in range(start[bucket], start[bucket + 1]):
        n = index[m]
        hit = rock_hit(ox, oy, oz, dx, dy, dz, rocks, n, planes, count)
        # A hit beyond this bucket is a hit all the same.
        if hit >= t - 1e-9 and hit < best:
            best = hit
            which = n
    return best, which


@kernel(inline=True)
def _steep_hit(
    ox, oy, oz, dx, dy, dz, u, v, du, dv, nu, nv, nz, t, t1, z,
    base, peak, ground, offset, high, wide, rocks, planes, count, start, index,
):  # fmt: skip
    """Return what `_first_hit` does for a ray that comes down steeply.

    It meets the ground within a few cells of the place where it gets below the highest point of
    a bucket, so this goes from there from cell to cell.
    """
    rows, cols = z.shape
    su = 1 if dx > 0.0 else -1
    sv = 1 if dy > 0.0 else -1
    wu = 1 if dx > 0.0 else 0
    wv = 1 if dy > 0.0 else 0
    width = wide[base]
    height = high[base]
    start_of_peaks = offset[base]
    best = np.inf
    which = -2
    cj = min(max(int(u + t * du), 0), cols - 2)
    ci = min(max(int(v + t * dv), 0), rows - 2)
    j = cj >> base
    i = ci >> base
    while True:
        bucket = i * width + j
        below = (np.float64(peak[start_of_peaks + bucket]) - oz) * nz
        if below > t:
            t = below
            cj = min(int(u + t * du), cols - 2) if t <= t1 else -1
            ci = min(int(v + t * dv), rows - 2) if t <= t1 else -1
        # The ray gets below the bucket's highest point before it leaves the bucket.
        inside = (cj >> base) == j and (ci >> base) == i
        if inside and start[bucket] < start[bucket + 1]:
            best, which = _try_rocks(
                ox, oy, oz, dx, dy, dz, t, bucket, best, which, rocks, planes, count, start, index
            )
            t1 = min(t1, best)
            below = (np.float64(ground[bucket]) - oz) * nz
            if below > t:
                t = below
                cj = min(int(u + t * du), cols - 2) if t <= t1 else -1
                ci = min(int(v + t * dv), rows - 2) if t <= t1 else -1
            inside = (cj >> base) == j and (ci >> base) == i
        if not inside:
            # Over the bucket: leave it through its nearer wall.
            tu = (((j + wu) << base) - u) * nu if du != 0.0 else np.inf
            tv = (((i + wv) << base) - v) * nv if dv != 0.0 else np.inf
            t = min(tu, tv)
            if t >= t1:
                return best, which
            if tu <= tv:
                j += su
            else:
                i += sv
            if j < 0 or j >= width or i < 0 or i >= height:
                return best, which
            cj = min(max(int(u + t * du), j << base), min((j + 1) << base, cols - 1) - 1)
            ci = min(max(int(v + t * dv), i << base), min((i + 1) << base, rows - 1) - 1)
            continue
        while True:
            cu = (cj + wu - u) * nu if du != 0.0 else np.inf
            cv = (ci + wv - v) * nv if dv != 0.0 else np.inf
            out = max(min(min(cu, cv), t1), t)
            hit = _cell_hit(z, ci, cj, u, v, oz, du, dv, dz, t, out)
            if hit < 0.0:
                return (best, which) if best <= t else (np.inf, -2)
            if hit < np.inf:
                return (hit, -1) if hit < best else (best, which)
            if out >= t1:
                return best, which
            t = out
            if cu <= cv:
                cj += su
            else:
                ci += sv
            if cj < 0 or cj > cols - 2 or ci < 0 or ci > rows - 2:
                return best, which
            if (cj >> base) != j or (ci >> base) != i:
                j = cj >> base
                i = ci >> base
                break


@kernel(inline=True)
def _first_hit(
    ox, oy, oz, dx, dy, dz, max_range, z, x0, y0, p,
    base, peak, ground, offset, high, wide, rocks, planes, count, start, index,
):  # fmt: skip
    """Return the distance of the first hit of one ray and the rock it met (-1 relief, -2 none).

    The ray walks over the pyramid: it steps over nodes that it passes above, and looks into the
    others one level down. At the level of the buckets it tries the rocks, at level 0 the two
    triangles of the cell. A ray that comes in underground meets nothing.
    """
    rows, cols = z.shape
    none = (np.inf, -2)
    # From here on in posts: the pyramid's nodes are then at whole numbers.
    q = 1.0 / p
    u = (ox - x0) * q
    v = (oy - y0) * q
    du = dx * q
    dv = dy * q
    # An infinite inverse would turn 0 * inf into NaN; this is as good as infinite.
    nu = 1.0 / du if abs(du) > 1e-200 else 1e200
    nv = 1.0 / dv if abs(dv) > 1e-200 else 1e200
    nz = 1.0 / dz if abs(dz) > 1e-200 else 1e200
    ta = -u * nu
    tb = (cols - 1 - u) * nu
    tc = -v * nv
    td = (rows - 1 - v) * nv
    t = max(max(0.0, min(ta, tb)), min(tc, td))
    t1 = min(min(max_range, max(ta, tb)), max(tc, td))
    last = offset.size - 1
    summit = np.float64(peak[offset[last]])
    if oz + t * dz > summit:
        if dz >= 0.0:
            return none
        t = max(t, (summit - oz) * nz)
    if not t <= t1:
        return none
    if dz < -0.3:
        return _steep_hit(
            ox, oy, oz, dx, dy, dz, u, v, du, dv, nu, nv, nz, t, t1, z,
            base, peak, ground, offset, high, wide, rocks, planes, count, start, index,
        )  # fmt: skip
    su = 1 if dx > 0.0 else -1
    sv = 1 if dy > 0.0 else -1
    # Offsets of the wall through which a node is left.
    wu = 1 if dx > 0.0 else 0
    wv = 1 if dy > 0.0 else 0
    level = base
    j = min(max(int(u + t * du), 0), cols - 2) >> level
    i = min(max(int(v + t * dv), 0), rows - 2) >> level
    best = np.inf
    which = -2
    while True:
        tu = (((j + wu) << level) - u) * nu if du != 0.0 else np.inf
        tv = (((i + wv) << level) - v) * nv if dv != 0.0 else np.inf
        leave = max(min(min(tu, tv), t1), t)
        low = oz + (leave if dz < 0.0 else t) * dz
        width = wide[level]
        bucket = i * width + j
        top = np.float64(peak[offset[level] + bucket])
        if low <= top:
            if dz < 0.0:
                t = min(max(t, (top - oz) * nz), leave)
            inside = True
            if level == base and start[bucket] < start[bucket + 1]:
                best, which = _try_rocks(
                    ox, oy, oz, dx, dy, dz, t, bucket, best, which,
                    rocks, planes, count, start, index,
                )  # fmt: skip
                t1 = min(t1, best)
                bare = np.float64(ground[bucket])
                leave = max(min(leave, t1), t)
                inside = oz + (leave if dz < 0.0 else t) * dz <= bare
                if inside and dz < 0.0:
                    t = min(max(t, (bare - oz) * nz), leave)
            if inside and level > 0:
                level -= 1
                j = min(max(int(u + t * du) >> level, 2 * j), min(2 * j + 1, wide[level] - 1))
                i = min(max(int(v + t * dv) >> level, 2 * i), min(2 * i + 1, high[level] - 1))
                continue
            if inside:
                hit = _cell_hit(z, i, j, u, v, oz, du, dv, dz, t, leave)
                if hit < 0.0:
                    return (best, which) if best <= t else none
                if hit < np.inf:
                    return (hit, -1) if hit < best else (best, which)
        t = leave
        if t >= t1:
            return best, which
        # A step out of a bucket must enter the next one through its list of rocks.
        shift = max(base - level, 1)
        if tu <= tv:
            here = j
            j += su
            there = j
            if j < 0 or j >= width:
                return best, which
        else:
            here = i
            i += sv
            there = i
            if i < 0 or i >= high[level]:
                return best, which
        rise = 0
        if (here >> shift) != (there >> shift):
            rise = min(shift, last - level)
        elif (here >> 1) != (there >> 1):
            rise = 1
        level += rise
        j >>= rise
        i >>= rise


@kernel(parallel=True)
def cast(
    origin, direction, max_range, normals, z, x0, y0, p,
    base, peak, ground, offset, high, wide, rocks, planes, count, start, index,
):  # fmt: skip
    """Cast rays; return distance (n,), normal (n, 3) and rock number (n,) of the first hits.

    Without `normals` the second is empty.
    """
    rays = direction.shape[0]
    distance = np.empty(rays)
    normal = np.empty((rays if normals else 0, 3))
    rock = np.empty(rays, np.int32)
    each = 1 if origin.shape[0] > 1 else 0
    for ray in prange(rays):
        ox = origin[ray * each, 0]
        oy = origin[ray * each, 1]
        oz = origin[ray * each, 2]
        dx = direction[ray, 0]
        dy = direction[ray, 1]
        dz = direction[ray, 2]
        best, which = _first_hit(
            ox, oy, oz, dx, dy, dz, max_range, z, x0, y0, p,
            base, peak, ground, offset, high, wide, rocks, planes, count, start, index,
        )  # fmt: skip
        rock[ray] = which
        distance[ray] = np.nan if which == -2 else best
        if normals:
            hx = ox + best * dx
            hy = oy + best * dy
            if which >= 0:
                rock_normal(hx, hy, oz + best * dz, rocks, which, planes, count, normal[ray])
            elif which == -1:
                relief_normal(hx, hy, z, x0, y0, p, normal[ray])
            else:
                normal[ray, :] = np.nan
    return distance, normal, rock
