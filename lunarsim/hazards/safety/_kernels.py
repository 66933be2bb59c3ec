"""Compiled landing-safety kernels. Rasters are float32 (rows, cols) without NaN."""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel, prange

FAR = np.float32(1e30)  # stands for unknown ground in maxima; far above any terrain


@kernel(parallel=True, fast=True)
def _double_windows(level, width, out):
    """Write maxima over windows of 2 * width cells, given those over `width` cells."""
    rows, cols = level.shape
    for i in prange(rows):
        for j in range(cols - width):
            out[i, j] = max(level[i, j], level[i, j + width])
        for j in range(max(cols - width, 0), cols):
            out[i, j] = level[i, j]


@kernel(parallel=True, fast=True)
def _run_maxima(levels, runs, reach, out):
    """Write the maximum over a set of runs around each cell at least `reach` from the edge.

    levels[k] holds maxima over windows of 2**k cells to the right; a run of any length is the
    union of two such windows.
    """
    rows, cols = out.shape
    for i in prange(reach, rows - reach):
        line = np.full(cols, -FAR, np.float32)
        for n in range(runs.shape[0]):
            k = 0
            while (2 << k) <= runs[n, 2]:
                k += 1
            source = levels[k, i + runs[n, 0]]
            first = runs[n, 1]
            last = first + runs[n, 2] - (1 << k)
            for j in range(reach, cols - reach):
                line[j] = max(line[j], max(source[j + first], source[j + last]))
        for j in range(reach, cols - reach):
            out[i, j] = line[j]


def run_maxima(z, runs, reach):
    """Return the maximum of z over a set of runs around each cell; FAR near the edge."""
    depth = max(1, int(runs[:, 2].max()).bit_length())
    levels = np.empty((depth, *z.shape), np.float32)
    levels[0] = z
    for k in range(1, depth):
        _double_windows(levels[k - 1], 1 << (k - 1), levels[k])
    out = np.full(z.shape, FAR, np.float32)
    _run_maxima(levels, runs, reach, out)
    return out


@kernel(parallel=True, fast=True)
def exact(z, feet, legs, inside, first_run, reach, posting, slope_out, rough_out):
    """Write tan(slope) and roughness, the worst over headings and admissible planes.

    `feet` is the highest ground under a pad centred on each cell. Rows run in parallel, cells
    of a row in SIMD lanes: for each cell of the polygon every lane lifts its own plane.
    """
    rows, cols = z.shape
    headings, count, _ = legs.shape
    planes = 2 if count == 4 else 1
    width = cols - 2 * reach
    for i in prange(reach, rows - reach):
        gx = np.empty((2, width), np.float32)
        gy = np.empty((2, width), np.float32)
        z0 = np.empty((2, width), np.float32)
        top = np.empty((2, width), np.float32)
        slope = np.zeros(width, np.float32)
        rough = np.zeros(width, np.float32)
        for h in range(headings):
            a = legs[h, 0]
            b = legs[h, 1]
            c = legs[h, 2]
            d = legs[h, count - 1]
            fa = feet[i + a[0], reach + a[1] : reach + a[1] + width]
            fb = feet[i + b[0], reach + b[1] : reach + b[1] + width]
            fc = feet[i + c[0], reach + c[1] : reach + c[1] + width]
            fd = feet[i + d[0], reach + d[1] : reach + d[1] + width]
            # Edge vectors of the triangles (column, row) and their inverse determinants.
            for s in range(planes):
                if count == 3:
                    p0, p1, p2 = a, b, c
                    q0, q1, q2 = a, b, c
                elif s == 0:
                    p0, p1, p2 = a, b, c  # diagonal a-c is the higher
                    q0, q1, q2 = a, b, d  # diagonal b-d is the higher
                else:
                    p0, p1, p2 = a, c, d
                    q0, q1, q2 = b, c, d
                pux = float(p1[1] - p0[1])
                puy = float(p1[0] - p0[0])
                pvx = float(p2[1] - p0[1])
                pvy = float(p2[0] - p0[0])
                pdet = 1.0 / (pux * pvy - pvx * puy)
                qux = float(q1[1] - q0[1])
                quy = float(q1[0] - q0[0])
                qvx = float(q2[1] - q0[1])
                qvy = float(q2[0] - q0[0])
                qdet = 1.0 / (qux * qvy - qvx * quy)
                pxx = np.float32(pvy * pdet)
                pxy = np.float32(-puy * pdet)
                pyx = np.float32(-pvx * pdet)
                pyy = np.float32(pux * pdet)
                qxx = np.float32(qvy * qdet)
                qxy = np.float32(-quy * qdet)
                qyx = np.float32(-qvx * qdet)
                qyy = np.float32(qux * qdet)
                p0r = np.float32(p0[0])
                p0c = np.float32(p0[1])
                q0r = np.float32(q0[0])
                q0c = np.float32(q0[1])
                for j in range(width):
                    za = fa[j]
                    zb = fb[j]
                    zc = fc[j]
                    zd = fd[j]
                    first = count == 3 or za + zc >= zb + zd
                    if count == 3:
                        z1, z2, z3 = za, zb, zc
                        y1, y2, y3 = za, zb, zc
                    elif s == 0:
                        z1, z2, z3 = za, zb, zc
                        y1, y2, y3 = za, zb, zd
                    else:
                        z1, z2, z3 = za, zc, zd
                        y1, y2, y3 = zb, zc, zd
                    px = pxx * (z2 - z1) + pxy * (z3 - z1)
                    py = pyx * (z2 - z1) + pyy * (z3 - z1)
                    qx = qxx * (y2 - y1) + qxy * (y3 - y1)
                    qy = qyx * (y2 - y1) + qyy * (y3 - y1)
                    gx[s, j] = px if first else qx
                    gy[s, j] = py if first else qy
                    pz = z1 - px * p0c - py * p0r
                    qz = y1 - qx * q0c - qy * q0r
                    z0[s, j] = pz if first else qz
                    top[s, j] = -FAR
            for r in range(first_run[h], first_run[h + 1]):
                dy = np.float32(inside[r, 1])
                row = z[i + inside[r, 1]]
                for col in range(inside[r, 2], inside[r, 2] + inside[r, 3]):
                    dx = np.float32(col)
                    source = row[reach + col : reach + col + width]
                    for s in range(planes):
                        for j in range(width):
                            height = source[j] - dx * gx[s, j] - dy * gy[s, j]
                            top[s, j] = max(top[s, j], height)
            for s in range(planes):
                for j in range(width):
                    tx = gx[s, j] / posting
                    ty = gy[s, j] / posting
                    square = tx * tx + ty * ty
                    slope[j] = max(slope[j], square)
                    rough[j] = max(
                        rough[j], (top[s, j] - z0[s, j]) / np.sqrt(np.float32(1.0) + square)
                    )
        for j in range(width):
            slope_out[i, reach + j] = np.sqrt(slope[j])
            rough_out[i, reach + j] = rough[j]


@kernel(parallel=True)
def probability(
    leg_hi, leg_lo, foot_hi, foot_lo, body_hi, body_lo, slope_margin, roughness_limit,
    p_slope, p_rough,
):  # fmt: skip
    """Write Eqs. 16 and 17 from the six bounds of Eq. 15.

    leg_*: max over L of mean +- 3 sigma; foot_*: min over L of mean +- 3 sigma; body_*: max
    over U of mean +- 3 sigma.
    """
    rows, cols = p_slope.shape
    for i in prange(rows):
        for j in range(cols):
            if leg_hi[i, j] >= FAR or body_hi[i, j] >= FAR:
                p_slope[i, j] = 0.0
                p_rough[i, j] = 0.0
                continue
            leg = 0.5 * (leg_hi[i, j] + leg_lo[i, j])
            leg_sd = (leg_hi[i, j] - leg_lo[i, j]) / 6.0
            foot = 0.5 * (foot_hi[i, j] + foot_lo[i, j])
            foot_sd = (foot_hi[i, j] - foot_lo[i, j]) / 6.0
            body = 0.5 * (body_hi[i, j] + body_lo[i, j])
            body_sd = (body_hi[i, j] - body_lo[i, j]) / 6.0
            s1 = math.sqrt(leg_sd * leg_sd + foot_sd * foot_sd)
            s2 = math.sqrt(body_sd * body_sd + foot_sd * foot_sd)
            d1 = slope_margin - (leg - foot)
            d2 = roughness_limit - (body - foot)
            # A certain map has no spread: the probability is a step.
            if s1 > 0.0:
                p_slope[i, j] = 0.5 * math.erfc(-d1 / s1 * 0.7071067811865476)
            else:
                p_slope[i, j] = 1.0 if d1 > 0.0 else 0.0
            if s2 > 0.0:
                p_rough[i, j] = 0.5 * math.erfc(-d2 / s2 * 0.7071067811865476)
            else:
                p_rough[i, j] = 1.0 if d2 > 0.0 else 0.0
