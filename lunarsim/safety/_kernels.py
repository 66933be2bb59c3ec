# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled landing-safety kernels. Rasters are float32 (rows, cols).

Maxima over footprints are computed tile by tile: a tile and its surroundings are loaded, maxima
over windows of 1, 2, 4, ... cells to the right are computed, and a run of any length is the union
of two such windows. A tile's buffers fit into the second-level cache.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from lunarsim._jit import kernel
from lunarsim._simd import SIMD_WIDTH, item, lane_fill, lane_max, load, store

FAR = np.float32(1e30)  # marks unknown terrain in maxima; far above any terrain
MAX_RELIEF_M = 30_000.0  # heights farther than this from the map's middle are invalid, m
TILE_ROWS = 64
TILE_COLS = 128


@kernel(inner=True)
def is_plausible_height(height, middle):
    """Return whether a height is finite and within 30 km of the map's middle height."""
    return abs(np.float64(height) - middle) <= MAX_RELIEF_M


@kernel(inner=True)
def insert_sorted(ascending, count, value):
    """Insert a value into the first `count` values of the sorted buffer `ascending`.

    For few values this is as fast as a library's sort, which takes a second to compile.
    """
    n = count
    while n > 0 and ascending[n - 1] > value:
        ascending[n] = ascending[n - 1]
        n -= 1
    ascending[n] = value


@kernel(inner=True)
def copy_window(source, out):
    """Copy a window (rows, cols) into `out`; a slice would take seconds to compile."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = source[i, j]


@kernel(inner=True)
def tile_datum(z, middle, r0, c0, rows, cols):
    """Return the reference height of a tile: the lower median of nine of its heights.

    The tile has `rows` x `cols` cells from (r0, c0) of the raster `z`. Unknown heights are ignored;
    if all nine are unknown, the result is the first known height, or `middle` if there is none.
    """
    found = np.empty(9)
    count = 0
    for a in range(1, 6, 2):
        for b in range(1, 6, 2):
            here = z[r0 + a * rows // 6, c0 + b * cols // 6]
            if is_plausible_height(here, middle):
                insert_sorted(found, count, here)
                count += 1
    if count > 0:
        return found[(count - 1) // 2]
    for i in range(r0, r0 + rows):
        for j in range(c0, c0 + cols):
            if is_plausible_height(z[i, j], middle):
                return np.float64(z[i, j])
    return np.float64(middle)


@kernel(fast=True)
def load_window(z, middle, datum, r0, c0, out):
    """Copy a window of the elevation raster `z`, minus `datum`, into `out` as float32.

    The window starts at row `r0`, column `c0` of the raster and has the shape of `out`; `middle` is
    the middle of the map's heights, m. Values are FAR off the raster and where the terrain is
    unknown. The subtraction precedes the rounding.
    """
    rows, cols = z.shape
    tall, wide = out.shape
    first = min(max(-c0, 0), wide)
    last = max(min(cols - c0, wide), first)
    for i in range(tall):
        line = out[i]
        r = r0 + i
        if r < 0 or r >= rows:
            line[:] = FAR
            continue
        line[:first] = FAR
        line[last:] = FAR
        here = z[r, c0 + first : c0 + last]
        there = line[first:last]
        for j in range(last - first):
            height = np.float64(here[j])
            there[j] = np.float32(height - datum) if abs(height - middle) <= MAX_RELIEF_M else FAR


@kernel(fast=True)
def load_variance(variance, r0, c0, out):
    """Copy a window of the variance raster from row `r0`, column `c0` on into `out`.

    Values are FAR off the raster and where the variance is NaN or infinite.
    """
    rows, cols = variance.shape
    tall, wide = out.shape
    first = min(max(-c0, 0), wide)
    last = max(min(cols - c0, wide), first)
    for i in range(tall):
        line = out[i]
        r = r0 + i
        line[:] = FAR
        if r >= 0 and r < rows:
            here = variance[r, c0 + first : c0 + last]
            there = line[first:last]
            for j in range(last - first):
                there[j] = here[j] if here[j] < FAR else FAR


@kernel(finite=True, inner=True)
def spread_bounds(mean, variance, high, low):
    """Write mean + 3 sigma of elevations to `high`, mean - 3 sigma to `low`; else FAR.

    Both are FAR where the mean or the variance is unknown (FAR).
    """
    for i in range(mean.shape[0]):
        for j in range(mean.shape[1]):
            z = mean[i, j]
            known = (z < FAR) & (variance[i, j] < FAR)
            s = np.float32(3.0) * np.sqrt(variance[i, j])
            high[i, j] = z + s if known else FAR
            low[i, j] = z - s if known else FAR


@kernel(finite=True)
def _negate(source, out):
    """Write the negative of `source` to `out`, or FAR where it is FAR (unknown)."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            z = source[i, j]
            out[i, j] = -z if z < FAR else FAR


@kernel(inner=True)
def allocate_levels(footprint, rows, cols):
    """Allocate buffers for the maxima over windows of 1, 2, 4, ... cells of a tile.

    There are `footprint.depth` buffers along rows, and `footprint.height` - 1 along columns, each
    of `rows` x `cols` cells.
    """
    return np.empty((footprint.depth + footprint.height - 1, rows, cols), np.float32)


@kernel(finite=True, inner=True)
def fill_row_maxima(levels, depth):
    """Write maxima of levels[0] over windows of 2**k columns to levels[k], k < depth.

    The window of a cell starts at the cell and ends to the east of it or at the last column.
    """
    _, rows, cols = levels.shape
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


@kernel(finite=True, inner=True)
def fill_column_maxima(levels, depth):
    """Write maxima of levels[0] over windows of 2**k rows to levels[depth - 1 + k].

    The window of a cell starts at the cell and ends to the north of it or at the last row.
    """
    deep, rows, cols = levels.shape
    for k in range(1, deep - depth + 1):
        before = levels[depth - 2 + k] if k > 1 else levels[0]
        here = levels[depth - 1 + k]
        for i in range(rows):
            a = before[i]
            b = before[min(i + (1 << (k - 1)), rows - 1)]
            out = here[i]
            for j in range(cols):
                out[j] = max(a[j], b[j])


@kernel(inner=True)
def fill_maxima(levels, footprint):
    """Write maxima of levels[0] over windows of 2, 4, ... cells to the other levels.

    `levels` is from `allocate_levels`: windows along rows are first, windows along columns last.
    """
    fill_row_maxima(levels, footprint.depth)
    fill_column_maxima(levels, footprint.depth)


@kernel(inner=True)
def write_footprint_max(levels, depth, window_pairs, reach, row_step, out):
    """Write the maximum over the footprint around each cell of a tile to `out`.

    The footprint is the union of `window_pairs` (4 n, 5), as in `Footprint`. `levels` are the
    maxima over windows (`fill_maxima`) with `depth` levels along rows. Row and column `reach` of a
    level correspond to the first cell of `out` (rows, cols), whose rows are `row_step` cells apart.
    """
    _, tall, wide = levels.shape
    rows, cols = out.shape
    flat = levels.reshape(levels.size)
    first = np.empty(len(window_pairs), np.int64)
    second = np.empty(len(window_pairs), np.int64)
    for n in range(len(window_pairs)):
        level = window_pairs[n, 0] if window_pairs[n, 0] >= 0 else depth - 1 - window_pairs[n, 0]
        start = (level * tall + reach) * wide + reach
        first[n] = start + window_pairs[n, 1] * wide + window_pairs[n, 2]
        second[n] = start + window_pairs[n, 3] * wide + window_pairs[n, 4]
    best = np.empty(8 * SIMD_WIDTH, np.float32)
    for i in range(rows):
        j = 0
        while j < cols:
            at = i * row_step * wide + j
            # Process many sites at a time, so that the loads of one window serve several sites.
            if cols - j > 7 * SIMD_WIDTH:
                _max_over_windows_64(flat, first, second, at, best, 0)
                _max_over_windows_64(flat, first, second, at + 4 * SIMD_WIDTH, best, 4 * SIMD_WIDTH)
                count = 8 * SIMD_WIDTH
            elif cols - j > 3 * SIMD_WIDTH:
                _max_over_windows_64(flat, first, second, at, best, 0)
                count = 4 * SIMD_WIDTH
            else:
                _max_over_windows(flat, first, second, at, best)
                count = SIMD_WIDTH
            for k in range(min(count, cols - j)):
                out[i, j + k] = best[k]
            j += count


@kernel(inline=True)
def _max_over_windows(flat, first, second, site, best):
    """Write the maximum over a footprint around sixteen neighbouring sites to `best`.

    `flat` are the flattened maxima over windows; `first` and `second` are the index offsets of the
    two windows of each pair; `site` is the index of the first site.
    """
    a = lane_fill(-FAR)
    b = a
    for n in range(len(first)):
        a = lane_max(a, load(flat, site + item(first, n)))
        b = lane_max(b, load(flat, site + item(second, n)))
    store(best, 0, lane_max(a, b))


@kernel(inline=True)
def _max_over_windows_64(flat, first, second, site, best, offset):
    """Write the maximum over a footprint around 64 neighbours to best[offset:].

    The other arguments are those of `_max_over_windows`, which does this for sixteen sites.
    """
    a = lane_fill(-FAR)
    b = a
    c = a
    d = a
    for n in range(len(first)):
        m = site + item(first, n)
        a = lane_max(a, load(flat, m))
        b = lane_max(b, load(flat, m + SIMD_WIDTH))
        c = lane_max(c, load(flat, m + 2 * SIMD_WIDTH))
        d = lane_max(d, load(flat, m + 3 * SIMD_WIDTH))
        m = site + item(second, n)
        a = lane_max(a, load(flat, m))
        b = lane_max(b, load(flat, m + SIMD_WIDTH))
        c = lane_max(c, load(flat, m + 2 * SIMD_WIDTH))
        d = lane_max(d, load(flat, m + 3 * SIMD_WIDTH))
    store(best, offset, a)
    store(best, offset + SIMD_WIDTH, b)
    store(best, offset + 2 * SIMD_WIDTH, c)
    store(best, offset + 3 * SIMD_WIDTH, d)


@kernel(inner=True)
def tiles_of(rows, cols, tile_rows):
    """Return the number of tiles in a row of tiles, and the total number of tiles.

    The raster has `rows` x `cols` cells; a tile has `tile_rows` rows and TILE_COLS columns.
    """
    across = (cols + TILE_COLS - 1) // TILE_COLS
    return across, across * ((rows + tile_rows - 1) // tile_rows)


@kernel(inline=True, inner=True)
def tile_at(tile, across, tile_rows, rows, cols):
    """Return first and end row, first and end column of a tile of a raster.

    The ends are exclusive. The raster has `rows` x `cols` cells; `tile` is the tile's index,
    `across` the number of tiles in a row of tiles, and `tile_rows` the rows of a tile.
    """
    r0, c0 = (tile // across) * tile_rows, (tile % across) * TILE_COLS
    return r0, min(r0 + tile_rows, rows), c0, min(c0 + TILE_COLS, cols)


@kernel(shared=True)
def footprint_extremes(thread_slice, z, middle, footprint, span, rise):
    """Write the height differences over each cell's footprint, m.

    By Eq. 10 of the Gaussian DEM paper, ``span`` = max over L minus min over L, and ``rise`` = max
    over U minus min over L. L are the cells that any pad may touch, U the cells under the lander.
    Both are FAR where L or U contains unknown terrain or leaves the raster. `thread_slice` is
    (first tile, step between tiles) of one thread.
    """
    rows, cols = z.shape
    reach = footprint.reach
    across, tiles = tiles_of(rows, cols, TILE_ROWS)
    for tile in range(thread_slice[0], tiles, thread_slice[1]):
        r0, r1, c0, c1 = tile_at(tile, across, TILE_ROWS, rows, cols)
        h, w = r1 - r0, c1 - c0
        levels = allocate_levels(footprint, h + 2 * reach, w + 2 * reach + SIMD_WIDTH)
        window = np.empty(levels.shape[1:], np.float32)
        leg = np.empty((2, h, w), np.float32)
        body = np.empty((h, w), np.float32)
        datum = tile_datum(z, middle, r0, c0, h, w)
        load_window(z, middle, datum, r0 - reach, c0 - reach, window)
        copy_window(window, levels[0])
        fill_maxima(levels, footprint)
        write_footprint_max(levels, footprint.depth, footprint.leg_windows, reach, 1, leg[0])
        write_footprint_max(levels, footprint.depth, footprint.body_windows, reach, 1, body)
        _negate(window, levels[0])
        fill_maxima(levels, footprint)
        write_footprint_max(levels, footprint.depth, footprint.leg_windows, reach, 1, leg[1])
        _write_span_and_rise(
            leg, body, span[r0 : r0 + h, c0 : c0 + w], rise[r0 : r0 + h, c0 : c0 + w]
        )


@kernel(finite=True)
def _write_span_and_rise(leg, body, span, rise):
    """Write span and rise (Eq. 10 of the Gaussian DEM paper) of a tile.

    `leg` (2, rows, cols) holds the maxima of z and of -z over the cells that a pad may touch,
    `body` (rows, cols) the maximum of z over the cells under the lander. `span` and `rise` (rows,
    cols) receive the results, FAR where the footprint is not completely known.
    """
    for i in range(span.shape[0]):
        for j in range(span.shape[1]):
            known = (leg[0, i, j] < FAR) & (body[i, j] < FAR)
            span[i, j] = leg[0, i, j] + leg[1, i, j] if known else FAR
            rise[i, j] = body[i, j] + leg[1, i, j] if known else FAR


# Table of the normal distribution from -6.5 to 6.5 sigma; linear interpolation errors are < 4e-7.
_STEPS = 4096
_NORMAL = ndtr(np.linspace(-6.5, 6.5, _STEPS + 1)).astype(np.float32)
_NORMAL[0] = 0.0


@kernel(inline=True)
def _normal_cdf(d, s):
    """Return P(x < d) for x ~ N(0, s^2), from a table; a step function where s is 0."""
    far = np.float32(7.0) if d > np.float32(0.0) else np.float32(-7.0)
    ratio = d / s if s > np.float32(0.0) else far
    x = (ratio + np.float32(6.5)) * np.float32(_STEPS / 13.0)
    x = min(max(x, np.float32(0.0)), np.float32(_STEPS))
    n = min(np.int32(x), np.int32(_STEPS - 1))
    low = _NORMAL[n]
    return low + (x - np.float32(n)) * (_NORMAL[n + 1] - low)


@kernel(finite=True)
def _write_safety(
    leg, foot, body, slope_margin, roughness_limit, p_slope, p_rough, p_safe, observed
):
    """Write the safety probabilities of Eq. 17 (Gaussian DEM paper) for a tile.

    Each of `leg`, `foot` and `body` (2, rows, cols) holds maxima of the upper and of the lower
    3-sigma bound of the height: `leg` of the bound and `foot` of its negative over the cells that a
    pad may touch, `body` of the bound over the cells under the lander. The last four arguments
    (rows, cols) are written: probabilities, 0 where the footprint is not known, and whether it is.
    """
    sixth, half = np.float32(1.0 / 6.0), np.float32(0.5)
    for i in range(p_slope.shape[0]):
        for j in range(p_slope.shape[1]):
            known = (leg[0, i, j] < FAR) & (body[0, i, j] < FAR)
            top_sd = (leg[0, i, j] - leg[1, i, j]) * sixth
            low_sd = (foot[1, i, j] - foot[0, i, j]) * sixth
            peak_sd = (body[0, i, j] - body[1, i, j]) * sixth
            low = -half * (foot[0, i, j] + foot[1, i, j])
            span = half * (leg[0, i, j] + leg[1, i, j]) - low
            rise = half * (body[0, i, j] + body[1, i, j]) - low
            s1 = np.sqrt(top_sd * top_sd + low_sd * low_sd)
            s2 = np.sqrt(peak_sd * peak_sd + low_sd * low_sd)
            a = _normal_cdf(slope_margin - span, s1) if known else np.float32(0.0)
            b = _normal_cdf(roughness_limit - rise, s2) if known else np.float32(0.0)
            p_slope[i, j] = a
            p_rough[i, j] = b
            p_safe[i, j] = a * b
            observed[i, j] = known


@kernel(shared=True)
def stochastic(
    thread_slice, mean, middle, variance, footprint, slope_margin, roughness_limit, p_slope,
    p_rough, p_safe, observed,
):  # fmt: skip
    """Write the safety probabilities of a lander at each cell, by a horizontal plane.

    These are Eqs. 15 to 17 of the Gaussian DEM paper. `p_slope`, `p_rough` and their product
    `p_safe` (rows, cols) are written, 0 where unobserved; `observed` is written as True where the
    footprint is known terrain. `mean` (m) and `variance` (m^2) are those of the elevation, `middle`
    is the middle of its heights, m; `slope_margin` and `roughness_limit` are limits of height
    differences, m. `thread_slice` is (first tile, step between tiles) of one thread.
    """
    rows, cols = mean.shape
    reach = footprint.reach
    across, tiles = tiles_of(rows, cols, TILE_ROWS)
    for tile in range(thread_slice[0], tiles, thread_slice[1]):
        r0, r1, c0, c1 = tile_at(tile, across, TILE_ROWS, rows, cols)
        h, w = r1 - r0, c1 - c0
        levels = allocate_levels(footprint, h + 2 * reach, w + 2 * reach + SIMD_WIDTH)
        leg = np.empty((2, h, w), np.float32)
        foot = np.empty((2, h, w), np.float32)
        body = np.empty((2, h, w), np.float32)
        window = np.empty((4, h + 2 * reach, w + 2 * reach + SIMD_WIDTH), np.float32)
        datum = tile_datum(mean, middle, r0, c0, h, w)
        load_window(mean, middle, datum, r0 - reach, c0 - reach, window[0])
        load_variance(variance, r0 - reach, c0 - reach, window[1])
        spread_bounds(window[0], window[1], window[2], window[3])
        for n in range(2):
            copy_window(window[2 + n], levels[0])
            fill_maxima(levels, footprint)
            write_footprint_max(levels, footprint.depth, footprint.leg_windows, reach, 1, leg[n])
            write_footprint_max(levels, footprint.depth, footprint.body_windows, reach, 1, body[n])
            _negate(window[2 + n], levels[0])
            fill_maxima(levels, footprint)
            write_footprint_max(levels, footprint.depth, footprint.leg_windows, reach, 1, foot[n])
        r1, c1 = r0 + h, c0 + w
        _write_safety(
            leg, foot, body, slope_margin, roughness_limit, p_slope[r0:r1, c0:c1],
            p_rough[r0:r1, c0:c1], p_safe[r0:r1, c0:c1], observed[r0:r1, c0:c1],
        )  # fmt: skip
