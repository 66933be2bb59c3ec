"""Compiled landing-safety kernels. Rasters are float32 (rows, cols).

Maxima over footprints are taken tile by tile: a tile and its surroundings are loaded, maxima over
windows of 1, 2, 4, ... cells to the right are built, and a run of any length is the union of two
such windows. A tile's buffers stay in the second-level cache.
"""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel, prange

FAR = np.float32(1e30)  # stands for unknown ground in maxima; far above any terrain
_TILE_ROWS = 64
_TILE_COLS = 128
_MEAN, _HIGH, _LOW = 0, 1, 2


@kernel(fast=True)
def _load(mean, variance, which, sign, r0, c0, out):
    """Copy a window whose corner is (r0, c0) into out[0]: sign * (mean + {0, 3, -3} sigma).

    Unknown ground and cells off the raster become FAR, for either sign.
    """
    rows, cols = mean.shape
    for i in range(out.shape[1]):
        r = r0 + i
        for j in range(out.shape[2]):
            c = c0 + j
            value = FAR
            if r >= 0 and r < rows and c >= 0 and c < cols:
                z = mean[r, c]
                if which == _HIGH:
                    z += np.float32(3.0) * np.sqrt(variance[r, c])
                elif which == _LOW:
                    z -= np.float32(3.0) * np.sqrt(variance[r, c])
                if np.isfinite(z):
                    value = sign * z
            out[0, i, j] = value


@kernel(fast=True)
def _double(levels):
    """Fill levels[k] with maxima over windows of 2**k cells, from levels[0]."""
    depth, rows, cols = levels.shape
    for k in range(1, depth):
        width = 1 << (k - 1)
        for i in range(rows):
            a = levels[k - 1, i, : cols - width]
            b = levels[k - 1, i, width:]
            out = levels[k, i]
            for j in range(cols - width):
                out[j] = max(a[j], b[j])
            for j in range(cols - width, cols):
                out[j] = levels[k - 1, i, j]


@kernel(fast=True)
def _over_runs(levels, runs, reach, out):
    """Write the maximum over a set of runs around each cell of the tile.

    A row of `runs` is (row offset, level, first window, second window); their number is a
    multiple of four, which keeps the running maximum in registers for longer.
    """
    rows, cols = out.shape
    for i in range(rows):
        line = out[i]
        for n in range(0, runs.shape[0], 4):
            r0 = levels[runs[n, 1], i + reach + runs[n, 0]]
            r1 = levels[runs[n + 1, 1], i + reach + runs[n + 1, 0]]
            r2 = levels[runs[n + 2, 1], i + reach + runs[n + 2, 0]]
            r3 = levels[runs[n + 3, 1], i + reach + runs[n + 3, 0]]
            a0 = r0[reach + runs[n, 2] : reach + runs[n, 2] + cols]
            b0 = r0[reach + runs[n, 3] : reach + runs[n, 3] + cols]
            a1 = r1[reach + runs[n + 1, 2] : reach + runs[n + 1, 2] + cols]
            b1 = r1[reach + runs[n + 1, 3] : reach + runs[n + 1, 3] + cols]
            a2 = r2[reach + runs[n + 2, 2] : reach + runs[n + 2, 2] + cols]
            b2 = r2[reach + runs[n + 2, 3] : reach + runs[n + 2, 3] + cols]
            a3 = r3[reach + runs[n + 3, 2] : reach + runs[n + 3, 2] + cols]
            b3 = r3[reach + runs[n + 3, 3] : reach + runs[n + 3, 3] + cols]
            if n == 0:
                for j in range(cols):
                    line[j] = max(
                        max(max(a0[j], b0[j]), max(a1[j], b1[j])),
                        max(max(a2[j], b2[j]), max(a3[j], b3[j])),
                    )
            else:
                for j in range(cols):
                    line[j] = max(
                        line[j],
                        max(
                            max(max(a0[j], b0[j]), max(a1[j], b1[j])),
                            max(max(a2[j], b2[j]), max(a3[j], b3[j])),
                        ),
                    )


@kernel()
def _tiles(rows, cols):
    across = (cols + _TILE_COLS - 1) // _TILE_COLS
    return across, across * ((rows + _TILE_ROWS - 1) // _TILE_ROWS)


@kernel(parallel=True)
def maximum(z, sign, runs, depth, reach, out):
    """Write the maximum of sign * z over a set of runs around each cell; FAR where unknown."""
    rows, cols = z.shape
    across, tiles = _tiles(rows, cols)
    for tile in prange(tiles):
        r0 = (tile // across) * _TILE_ROWS
        c0 = (tile % across) * _TILE_COLS
        h = min(_TILE_ROWS, rows - r0)
        w = min(_TILE_COLS, cols - c0)
        levels = np.empty((depth, h + 2 * reach, w + 2 * reach), np.float32)
        _load(z, z, _MEAN, np.float32(sign), r0 - reach, c0 - reach, levels)
        _double(levels)
        _over_runs(levels, runs, reach, out[r0 : r0 + h, c0 : c0 + w])


@kernel(parallel=True)
def extremes(z, leg_runs, body_runs, depth, reach, leg_max, leg_min, body_max):
    """Write max over L, min over L and max over U (Eq. 10) around each cell.

    Where L or U holds unknown ground or leaves the raster the maximum concerned is FAR.
    """
    rows, cols = z.shape
    across, tiles = _tiles(rows, cols)
    for tile in prange(tiles):
        r0 = (tile // across) * _TILE_ROWS
        c0 = (tile % across) * _TILE_COLS
        h = min(_TILE_ROWS, rows - r0)
        w = min(_TILE_COLS, cols - c0)
        levels = np.empty((depth, h + 2 * reach, w + 2 * reach), np.float32)
        _load(z, z, _MEAN, np.float32(1.0), r0 - reach, c0 - reach, levels)
        _double(levels)
        _over_runs(levels, leg_runs, reach, leg_max[r0 : r0 + h, c0 : c0 + w])
        _over_runs(levels, body_runs, reach, body_max[r0 : r0 + h, c0 : c0 + w])
        _load(z, z, _MEAN, np.float32(-1.0), r0 - reach, c0 - reach, levels)
        _double(levels)
        _over_runs(levels, leg_runs, reach, leg_min[r0 : r0 + h, c0 : c0 + w])
        for i in range(r0, r0 + h):
            for j in range(c0, c0 + w):
                leg_min[i, j] = -leg_min[i, j]


@kernel()
def _normal_cdf(d, s):
    """Return P(x < d) for x ~ N(0, s^2); a step where s is 0."""
    if s <= 0.0:
        return 1.0 if d > 0.0 else 0.0
    x = d / s
    if x > 6.5:
        return 1.0
    if x < -6.5:
        return 0.0
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@kernel(parallel=True)
def stochastic(
    mean, variance, leg_runs, body_runs, depth, reach, slope_margin, roughness_limit, p_slope,
    p_rough, p_safe, observed,
):  # fmt: skip
    """Write Eqs. 15 to 17 around each cell; observed is False where ground is unknown."""
    rows, cols = mean.shape
    across, tiles = _tiles(rows, cols)
    for tile in prange(tiles):
        r0 = (tile // across) * _TILE_ROWS
        c0 = (tile % across) * _TILE_COLS
        h = min(_TILE_ROWS, rows - r0)
        w = min(_TILE_COLS, cols - c0)
        levels = np.empty((depth, h + 2 * reach, w + 2 * reach), np.float32)
        leg = np.empty((2, h, w), np.float32)
        foot = np.empty((2, h, w), np.float32)
        body = np.empty((2, h, w), np.float32)
        for n in range(2):
            which = _HIGH if n == 0 else _LOW
            _load(mean, variance, which, np.float32(1.0), r0 - reach, c0 - reach, levels)
            _double(levels)
            _over_runs(levels, leg_runs, reach, leg[n])
            _over_runs(levels, body_runs, reach, body[n])
            _load(mean, variance, which, np.float32(-1.0), r0 - reach, c0 - reach, levels)
            _double(levels)
            _over_runs(levels, leg_runs, reach, foot[n])
        for i in range(h):
            for j in range(w):
                r = r0 + i
                c = c0 + j
                if leg[0, i, j] >= FAR or body[0, i, j] >= FAR:
                    p_slope[r, c] = 0.0
                    p_rough[r, c] = 0.0
                    p_safe[r, c] = 0.0
                    observed[r, c] = False
                    continue
                top = 0.5 * (leg[0, i, j] + leg[1, i, j])
                top_sd = (leg[0, i, j] - leg[1, i, j]) / 6.0
                low = -0.5 * (foot[0, i, j] + foot[1, i, j])
                low_sd = (foot[1, i, j] - foot[0, i, j]) / 6.0
                peak = 0.5 * (body[0, i, j] + body[1, i, j])
                peak_sd = (body[0, i, j] - body[1, i, j]) / 6.0
                s1 = math.sqrt(top_sd * top_sd + low_sd * low_sd)
                s2 = math.sqrt(peak_sd * peak_sd + low_sd * low_sd)
                a = _normal_cdf(slope_margin - (top - low), s1)
                b = _normal_cdf(roughness_limit - (peak - low), s2)
                p_slope[r, c] = a
                p_rough[r, c] = b
                p_safe[r, c] = a * b
                observed[r, c] = True


@kernel(fast=True)
def _lift(source, first, count, g, low, best, top):
    """Raise `top` to max over `count` columns from `first` of source - column * g, less low."""
    width = top.size
    c = 0
    for j in range(width):
        best[j] = -FAR
    while c + 4 <= count:
        d = np.float32(first + c)
        s0 = source[c : c + width]
        s1 = source[c + 1 : c + 1 + width]
        s2 = source[c + 2 : c + 2 + width]
        s3 = source[c + 3 : c + 3 + width]
        for j in range(width):
            v0 = s0[j] - d * g[j]
            v1 = s1[j] - (d + np.float32(1.0)) * g[j]
            v2 = s2[j] - (d + np.float32(2.0)) * g[j]
            v3 = s3[j] - (d + np.float32(3.0)) * g[j]
            best[j] = max(best[j], max(max(v0, v1), max(v2, v3)))
        c += 4
    while c < count:
        d = np.float32(first + c)
        s0 = source[c : c + width]
        for j in range(width):
            best[j] = max(best[j], s0[j] - d * g[j])
        c += 1
    for j in range(width):
        top[j] = max(top[j], best[j] - low[j])


@kernel(fast=True)
def _plane(p0, p1, p2, z0, z1, z2, gx, gy, base):
    """Write gradient (per cell) and height at the centre of the planes through three legs.

    p*: cells (row, column) of the legs; z*: heights under them (width,).
    """
    ux = float(p1[1] - p0[1])
    uy = float(p1[0] - p0[0])
    vx = float(p2[1] - p0[1])
    vy = float(p2[0] - p0[0])
    det = 1.0 / (ux * vy - vx * uy)
    xx = np.float32(vy * det)
    xy = np.float32(-uy * det)
    yx = np.float32(-vx * det)
    yy = np.float32(ux * det)
    row = np.float32(p0[0])
    col = np.float32(p0[1])
    for j in range(gx.size):
        e = z1[j] - z0[j]
        f = z2[j] - z0[j]
        x = xx * e + xy * f
        y = yx * e + yy * f
        gx[j] = x
        gy[j] = y
        base[j] = z0[j] - x * col - y * row


@kernel(parallel=True, fast=True)
def exact(z, feet, legs, inside, first_run, reach, posting, slope_out, rough_out):
    """Write tan(slope) and roughness, the worst over headings and admissible planes.

    `feet` is the highest ground under a pad centred on each cell. Stretches of a row run in
    parallel, cells of a stretch in SIMD lanes: for each cell of the polygon every lane lowers
    its own plane.
    """
    rows, cols = z.shape
    headings, count, _ = legs.shape
    planes = 2 if count == 4 else 1
    across = (cols - 2 * reach + _TILE_COLS - 1) // _TILE_COLS
    for task in prange((rows - 2 * reach) * across):
        i = reach + task // across
        c0 = reach + (task % across) * _TILE_COLS
        width = min(_TILE_COLS, cols - reach - c0)
        work = np.empty((11, width), np.float32)
        gx = work[0]
        gy = work[1]
        base = work[2]
        other_gx = work[3]
        other_gy = work[4]
        other_base = work[5]
        best = work[6]
        top = work[7]
        low = work[8]
        slope = work[9]
        rough = work[10]
        slope[:] = 0.0
        rough[:] = 0.0
        step = np.float32(posting)
        for h in range(headings):
            a = legs[h, 0]
            b = legs[h, 1]
            c = legs[h, 2]
            d = legs[h, count - 1]
            za = feet[i + a[0], c0 + a[1] : c0 + a[1] + width]
            zb = feet[i + b[0], c0 + b[1] : c0 + b[1] + width]
            zc = feet[i + c[0], c0 + c[1] : c0 + c[1] + width]
            zd = feet[i + d[0], c0 + d[1] : c0 + d[1] + width]
            for s in range(planes):
                if count == 3:
                    _plane(a, b, c, za, zb, zc, gx, gy, base)
                elif s == 0:
                    _plane(a, b, c, za, zb, zc, gx, gy, base)
                    _plane(a, b, d, za, zb, zd, other_gx, other_gy, other_base)
                else:
                    _plane(a, c, d, za, zc, zd, gx, gy, base)
                    _plane(b, c, d, zb, zc, zd, other_gx, other_gy, other_base)
                if count == 4:
                    for j in range(width):
                        first = za[j] + zc[j] >= zb[j] + zd[j]
                        gx[j] = gx[j] if first else other_gx[j]
                        gy[j] = gy[j] if first else other_gy[j]
                        base[j] = base[j] if first else other_base[j]
                for j in range(width):
                    top[j] = -FAR
                for r in range(first_run[h], first_run[h + 1]):
                    dy = np.float32(inside[r, 1])
                    for j in range(width):
                        low[j] = dy * gy[j]
                    first_col = inside[r, 2]
                    source = z[i + inside[r, 1], c0 + first_col :]
                    _lift(source, first_col, inside[r, 3], gx, low, best, top)
                for j in range(width):
                    tx = gx[j] / step
                    ty = gy[j] / step
                    square = tx * tx + ty * ty
                    slope[j] = max(slope[j], square)
                    height = (top[j] - base[j]) / np.sqrt(np.float32(1.0) + square)
                    rough[j] = max(rough[j], height)
        for j in range(width):
            slope_out[i, c0 + j] = np.sqrt(slope[j])
            rough_out[i, c0 + j] = rough[j]
