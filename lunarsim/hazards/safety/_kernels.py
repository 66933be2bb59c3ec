"""Compiled landing-safety kernels. Rasters are float32 (rows, cols).

Maxima over footprints are taken tile by tile: a tile and its surroundings are loaded, maxima over
windows of 1, 2, 4, ... cells to the right are built, and a run of any length is the union of two
such windows. A tile's buffers stay in the second-level cache.
"""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim._lanes import LANES, larger, load, spread, store

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


@kernel()
def _over_runs(levels, runs, reach, out):
    """Write the maximum over a set of runs around each cell of the tile.

    A row of `runs` is (row offset, level, first window, second window); their number is a
    multiple of four. A row of the tile has LANES columns to spare behind its surroundings.
    """
    _, tall, wide = levels.shape
    rows, cols = out.shape
    flat = levels.reshape(levels.size)
    first = np.empty(len(runs), np.int64)
    second = np.empty(len(runs), np.int64)
    for n in range(len(runs)):
        start = (runs[n, 1] * tall + reach + runs[n, 0]) * wide + reach
        first[n] = start + runs[n, 2]
        second[n] = start + runs[n, 3]
    best = np.empty(LANES, np.float32)
    for i in range(rows):
        for j in range(0, cols, LANES):
            store(best, 0, _best(flat, first, second, i * wide + j))
            for k in range(min(LANES, cols - j)):
                out[i, j + k] = best[k]


@kernel(inline=True)
def _best(flat, first, second, at):
    """Return the maximum over the windows of all runs."""
    a = spread(-FAR)
    b = a
    c = a
    d = a
    for n in range(0, len(first), 4):
        a = larger(a, larger(load(flat, at + first[n]), load(flat, at + second[n])))
        b = larger(b, larger(load(flat, at + first[n + 1]), load(flat, at + second[n + 1])))
        c = larger(c, larger(load(flat, at + first[n + 2]), load(flat, at + second[n + 2])))
        d = larger(d, larger(load(flat, at + first[n + 3]), load(flat, at + second[n + 3])))
    return larger(larger(a, b), larger(c, d))


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
        levels = np.empty((depth, h + 2 * reach, w + 2 * reach + LANES), np.float32)
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
        levels = np.empty((depth, h + 2 * reach, w + 2 * reach + LANES), np.float32)
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
        levels = np.empty((depth, h + 2 * reach, w + 2 * reach + LANES), np.float32)
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
