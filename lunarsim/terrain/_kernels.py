"""Compiled terrain queries.

The relief is a grid of posts `z` (rows, cols) whose post (0, 0) lies at (x0, y0). Squares of
`leaf` x `leaf` cells are buckets: each lists the rocks whose outline touches it (`start`,
`index`, in compressed rows) and the highest point in it (`top`). A row of `rocks` is
(x, y, base, a, b, height, cos yaw, sin yaw).
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange


@kernel()
def relief_at(x, y, z, x0, y0, p):
    """Return the elevation of the triangulated relief, NaN outside."""
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
def _rock_height(x, y, rocks, n):
    """Return the elevation of the top of rock n above (x, y), -inf outside it."""
    dx = x - rocks[n, 0]
    dy = y - rocks[n, 1]
    c = rocks[n, 6]
    s = rocks[n, 7]
    e = (c * dx + s * dy) / rocks[n, 3]
    f = (c * dy - s * dx) / rocks[n, 4]
    d = e * e + f * f
    result = -np.inf
    if d < 1.0:
        result = rocks[n, 2] + rocks[n, 5] * np.sqrt(1.0 - d)
    return result


@kernel()
def _top_rock(x, y, x0, y0, p, leaf, rocks, start, index, cols):
    """Return the elevation and number of the highest rock over (x, y), or (-inf, -1)."""
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
        top = _rock_height(x, y, rocks, n)
        if top > best:
            best = top
            which = n
    return best, which


@kernel()
def _surface(x, y, z, x0, y0, p, leaf, rocks, start, index):
    ground = relief_at(x, y, z, x0, y0, p)
    if np.isnan(ground) or rocks.shape[0] == 0:
        return ground
    top, _ = _top_rock(x, y, x0, y0, p, leaf, rocks, start, index, z.shape[1])
    return max(ground, top)


@kernel()
def elevation_at(xy, z, x0, y0, p, leaf, rocks, start, index):
    """Return the surface elevation (n,) at points (n, 2)."""
    out = np.empty(xy.shape[0])
    for i in range(xy.shape[0]):
        out[i] = _surface(xy[i, 0], xy[i, 1], z, x0, y0, p, leaf, rocks, start, index)
    return out


@kernel(parallel=True)
def raster(gx, gy, gp, rows, cols, z, x0, y0, p, leaf, rocks, start, index):
    """Return the surface elevation at the cell centres of a grid (rows, cols), float32."""
    out = np.empty((rows, cols), np.float32)
    for i in prange(rows):
        y = gy + gp * i
        for j in range(cols):
            out[i, j] = _surface(gx + gp * j, y, z, x0, y0, p, leaf, rocks, start, index)
    return out


@kernel()
def _relief_normal(x, y, z, x0, y0, p, out):
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
def _rock_normal(x, y, h, rocks, n, out):
    """Write the unit outward normal of rock n at the surface point (x, y, base + h)."""
    h = max(h, 0.0)  # below the base the skirt is vertical
    c = rocks[n, 6]
    s = rocks[n, 7]
    dx = x - rocks[n, 0]
    dy = y - rocks[n, 1]
    e = (c * dx + s * dy) / (rocks[n, 3] * rocks[n, 3])
    f = (c * dy - s * dx) / (rocks[n, 4] * rocks[n, 4])
    g = h / (rocks[n, 5] * rocks[n, 5])
    norm = np.sqrt(e * e + f * f + g * g)
    out[0] = (c * e - s * f) / norm
    out[1] = (s * e + c * f) / norm
    out[2] = g / norm


@kernel()
def normal_at(xy, z, x0, y0, p, leaf, rocks, start, index):
    """Return the unit surface normal (n, 3) at points (n, 2)."""
    out = np.full((xy.shape[0], 3), np.nan)
    for i in range(xy.shape[0]):
        x = xy[i, 0]
        y = xy[i, 1]
        ground = relief_at(x, y, z, x0, y0, p)
        if np.isnan(ground):
            continue
        top = -np.inf
        n = -1
        if rocks.shape[0] > 0:
            top, n = _top_rock(x, y, x0, y0, p, leaf, rocks, start, index, z.shape[1])
        if top > ground:
            _rock_normal(x, y, top - rocks[n, 2], rocks, n, out[i])
        else:
            _relief_normal(x, y, z, x0, y0, p, out[i])
    return out


@kernel()
def build_buckets(z, x0, y0, p, leaf, rocks):
    """Return the rock lists (start, index) and the highest point of every bucket."""
    rows, cols = z.shape
    height = (rows - 2) // leaf + 1
    width = (cols - 2) // leaf + 1
    top = np.full((height, width), -np.inf, np.float32)
    for i in range(height):
        for j in range(width):
            best = np.float32(-np.inf)
            for r in range(i * leaf, min((i + 1) * leaf, rows - 1) + 1):
                for c in range(j * leaf, min((j + 1) * leaf, cols - 1) + 1):
                    best = max(best, z[r, c])
            top[i, j] = best
    start = np.zeros(height * width + 1, np.int64)
    index = np.empty(0, np.int64)
    side = leaf * p
    for fill in range(2):
        if fill == 1:
            for bucket in range(height * width):
                start[bucket + 1] += start[bucket]
            index = np.empty(start[-1], np.int64)
            start[1:] = start[:-1].copy()
            start[0] = 0
        for n in range(rocks.shape[0]):
            reach = max(rocks[n, 3], rocks[n, 4])
            j0 = max(int(np.floor((rocks[n, 0] - reach - x0) / side)), 0)
            j1 = min(int(np.floor((rocks[n, 0] + reach - x0) / side)), width - 1)
            i0 = max(int(np.floor((rocks[n, 1] - reach - y0) / side)), 0)
            i1 = min(int(np.floor((rocks[n, 1] + reach - y0) / side)), height - 1)
            # Rounded up: the bucket's top must never be below the rock's.
            peak = np.float32(
                np.nextafter(np.float32(rocks[n, 2] + rocks[n, 5]), np.float32(np.inf))
            )
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    bucket = i * width + j
                    if fill == 0:
                        start[bucket + 1] += 1
                        top[i, j] = max(top[i, j], peak)
                    else:
                        index[start[bucket + 1]] = n
                        start[bucket + 1] += 1
    return start, index, top


@kernel()
def _cell_hit(i, j, ox, oy, oz, dx, dy, dz, t0, t1, z, x0, y0, p):
    """Return the distance at which a ray meets the two triangles of cell (i, j).

    The answer is inf for none and -1 for a ray that enters the cell underground.

    Within a triangle the surface is a plane, so the height of the ray above it is linear in
    the distance. The ray's stay in the cell, [t0, t1], is cut at the diagonal.
    """
    z00 = np.float64(z[i, j])
    z10 = np.float64(z[i, j + 1])
    z01 = np.float64(z[i + 1, j])
    z11 = np.float64(z[i + 1, j + 1])
    hit = np.inf
    highest = max(max(z00, z10), max(z01, z11))
    if min(oz + t0 * dz, oz + t1 * dz) <= highest or np.isnan(highest):
        u0 = (ox + t0 * dx - x0) / p - j
        v0 = (oy + t0 * dy - y0) / p - i
        u1 = (ox + t1 * dx - x0) / p - j
        v1 = (oy + t1 * dy - y0) / p - i
        s0 = u0 - v0
        s1 = u1 - v1
        tm = t1
        if (s0 < 0.0) != (s1 < 0.0):
            tm = t0 + (t1 - t0) * s0 / (s0 - s1)
        ta = t0
        tb = tm
        for _ in range(2):
            ua = (ox + ta * dx - x0) / p - j
            va = (oy + ta * dy - y0) / p - i
            ub = (ox + tb * dx - x0) / p - j
            vb = (oy + tb * dy - y0) / p - i
            if ua + ub >= va + vb:  # the middle of the stretch tells its triangle
                gu = z10 - z00
                gv = z11 - z10
            else:
                gu = z11 - z01
                gv = z01 - z00
            ha = oz + ta * dz - (z00 + gu * ua + gv * va)
            hb = oz + tb * dz - (z00 + gu * ub + gv * vb)
            if ha < -1e-6:  # came in from below, past no-data or the edge of the map
                hit = -1.0
                break
            # Rounding may put a point on the ground a hair below it: still a hit.
            if hb <= 0.0:
                hit = ta
                if ha > hb:
                    hit = ta + (tb - ta) * max(ha, 0.0) / (ha - hb)
                break
            if tm >= t1:
                break
            ta = tm
            tb = t1
    return hit


@kernel()
def _rock_hit(ox, oy, oz, dx, dy, dz, rocks, n):
    """Return the distance at which a ray enters rock n from outside, else inf."""
    c = rocks[n, 6]
    s = rocks[n, 7]
    rx = ox - rocks[n, 0]
    ry = oy - rocks[n, 1]
    rz = oz - rocks[n, 2]
    ex = (c * rx + s * ry) / rocks[n, 3]
    ey = (c * ry - s * rx) / rocks[n, 4]
    ez = rz / rocks[n, 5]
    fx = (c * dx + s * dy) / rocks[n, 3]
    fy = (c * dy - s * dx) / rocks[n, 4]
    fz = dz / rocks[n, 5]
    qa = fx * fx + fy * fy + fz * fz
    # Move the origin to the point of closest approach: this keeps full precision far away.
    tc = -(ex * fx + ey * fy + ez * fz) / qa
    ex += tc * fx
    ey += tc * fy
    ez += tc * fz
    qc = ex * ex + ey * ey + ez * ez - 1.0
    hit = np.inf
    if qc < 0.0:
        t = tc - np.sqrt(-qc / qa)
        if rz + t * dz >= 0.0:
            hit = t
    if hit == np.inf:
        # The skirt: the outline carried straight down from the base to the relief.
        wa = fx * fx + fy * fy
        if wa > 0.0:
            tw = -(ex * fx + ey * fy) / wa
            wx = ex + tw * fx
            wy = ey + tw * fy
            wc = wx * wx + wy * wy - 1.0
            if wc < 0.0:
                t = tc + tw - np.sqrt(-wc / wa)
                if rz + t * dz < 0.0:
                    hit = t
    return hit


@kernel()
def _cast_one(
    ox, oy, oz, dx, dy, dz, max_range, ceiling, z, x0, y0, p, leaf, top, rocks, start, index
):
    """Return the distance of the first hit of one ray and the rock it met (-1 relief, -2 none).

    The ray walks over the buckets it crosses (Amanatides and Woo 1987), skips those that it
    passes above, and inside the others walks over the relief's cells and tries the rocks.
    """
    rows, cols = z.shape
    height, width = top.shape
    side = leaf * p
    east = x0 + (cols - 1) * p
    north = y0 + (rows - 1) * p
    best = np.inf
    which = -2
    # The stretch of the ray inside the map's outline and below its highest point.
    t0 = 0.0
    t1 = max_range
    if dx != 0.0:
        ta = (x0 - ox) / dx
        tb = (east - ox) / dx
        t0 = max(t0, min(ta, tb))
        t1 = min(t1, max(ta, tb))
    elif ox < x0 or ox > east:
        t1 = -1.0
    if dy != 0.0:
        ta = (y0 - oy) / dy
        tb = (north - oy) / dy
        t0 = max(t0, min(ta, tb))
        t1 = min(t1, max(ta, tb))
    elif oy < y0 or oy > north:
        t1 = -1.0
    if oz + t0 * dz > ceiling:
        if dz < 0.0:
            t0 = max(t0, (ceiling - oz) / dz)
        else:
            t1 = -1.0
    if t0 > t1:
        return best, which
    ix = min(max(int((ox + t0 * dx - x0) / side), 0), width - 1)
    iy = min(max(int((oy + t0 * dy - y0) / side), 0), height - 1)
    sx = 1 if dx > 0.0 else -1
    sy = 1 if dy > 0.0 else -1
    # Offsets of the wall through which a cell is left.
    wx = 1 if dx > 0.0 else 0
    wy = 1 if dy > 0.0 else 0
    t = t0
    while t <= t1:
        tx = (x0 + side * (ix + wx) - ox) / dx if dx != 0.0 else np.inf
        ty = (y0 + side * (iy + wy) - oy) / dy if dy != 0.0 else np.inf
        leave = max(min(min(tx, ty), t1), t)
        if min(oz + t * dz, oz + leave * dz) <= top[iy, ix]:
            bucket = iy * width + ix
            for m in range(start[bucket], start[bucket + 1]):
                n = index[m]
                tr = _rock_hit(ox, oy, oz, dx, dy, dz, rocks, n)
                if tr < best and tr >= t - 1e-9 and tr <= leave + 1e-9:
                    best = tr
                    which = n
            j0 = ix * leaf
            j1 = min(j0 + leaf, cols - 1) - 1
            i0 = iy * leaf
            i1 = min(i0 + leaf, rows - 1) - 1
            j = min(max(int((ox + t * dx - x0) / p), j0), j1)
            i = min(max(int((oy + t * dy - y0) / p), i0), i1)
            tc = t
            while tc <= leave and tc < best:
                cx = (x0 + p * (j + wx) - ox) / dx if dx != 0.0 else np.inf
                cy = (y0 + p * (i + wy) - oy) / dy if dy != 0.0 else np.inf
                out = max(min(min(cx, cy), leave), tc)
                tg = _cell_hit(i, j, ox, oy, oz, dx, dy, dz, tc, out, z, x0, y0, p)
                if tg < 0.0:
                    return (best, which) if best < tc else (np.inf, -2)
                if tg < np.inf:
                    if tg < best:
                        best = tg
                        which = -1
                    break
                if cx <= cy:
                    j += sx
                else:
                    i += sy
                if j < j0 or j > j1 or i < i0 or i > i1:
                    break
                tc = out
            if best < np.inf:
                break
        if tx <= ty:
            ix += sx
        else:
            iy += sy
        if ix < 0 or ix >= width or iy < 0 or iy >= height:
            break
        t = leave
    return best, which


@kernel(parallel=True)
def cast(origin, direction, max_range, z, x0, y0, p, leaf, top, rocks, start, index):
    """Cast rays; return distance (n,), normal (n, 3) and rock number (n,) of the first hits."""
    count = direction.shape[0]
    distance = np.empty(count)
    normal = np.full((count, 3), np.nan)
    rock = np.empty(count, np.int64)
    each = 1 if origin.shape[0] > 1 else 0
    ceiling = np.float64(top.max())
    for ray in prange(count):
        o = origin[ray * each]
        d = direction[ray]
        best, which = _cast_one(
            o[0], o[1], o[2], d[0], d[1], d[2], max_range, ceiling,
            z, x0, y0, p, leaf, top, rocks, start, index,
        )  # fmt: skip
        rock[ray] = which
        distance[ray] = np.nan if which == -2 else best
        hx = o[0] + best * d[0]
        hy = o[1] + best * d[1]
        if which >= 0:
            h = o[2] + best * d[2] - rocks[which, 2]
            _rock_normal(hx, hy, h, rocks, which, normal[ray])
        elif which == -1:
            _relief_normal(hx, hy, z, x0, y0, p, normal[ray])
    return distance, normal, rock
