# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled kernels that evaluate the support planes of every heading.

They work tile by tile. The windows of a tile are flat, float32, without NaN, and end in spare rows
that may be read; sixteen neighbouring sites of a row are processed at a time. Lanes beyond the last
site read following values, and their results are discarded.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim._simd import (
    SIMD_WIDTH,
    item,
    lane_abs,
    lane_fill,
    lane_max,
    lane_sqrt,
    load,
    select_ge,
    store,
)
from lunarsim.safety._kernels import (
    FAR,
    copy,
    datum_of,
    double,
    levels_of,
    load_variance,
    load_window,
    over_runs,
    spread_bounds,
    tile_at,
    tiles_of,
)


@kernel(inline=True)
def plane(feet, here, legs, inverse, place, h, s):
    """Return gradient (per cell) and centre height of a support plane of the legs.

    It is plane `s` of heading `h`, for sixteen sites; `legs` are index offsets of the legs,
    `inverse` and `place` as in `FootprintArrays`.

    `feet` holds the terrain height under a pad; `here` is the index of the first site.
    """
    za = load(feet, here + legs[h, 0])
    zb = load(feet, here + legs[h, 1])
    zc = load(feet, here + legs[h, 2])
    if legs.shape[1] == 3:
        m = inverse[h, 0, 0]
        q = place[h, 0, 0]
        u = zb - za
        v = zc - za
        gx = m[0] * u + m[1] * v
        gy = m[2] * u + m[3] * v
        return gx, gy, za - q[0] * gy - q[1] * gx
    zd = load(feet, here + legs[h, 3])
    # The higher diagonal carries the lander: plane 0 on a b c or a b d, plane 1 on a c d or b c d.
    one = za + zc
    two = zb + zd
    if s == 0:
        z0 = za
        u = zb - z0
        v = select_ge(one, two, zc, zd) - z0
    else:
        z0 = select_ge(one, two, za, zb)
        u = zc - z0
        v = zd - z0
    m = inverse[h, s, 0]
    n = inverse[h, s, 1]
    p = place[h, s, 0]
    q = place[h, s, 1]
    gx = select_ge(one, two, m[0] * u + m[1] * v, n[0] * u + n[1] * v)
    gy = select_ge(one, two, m[2] * u + m[3] * v, n[2] * u + n[3] * v)
    level = select_ge(one, two, p[0] * gy + p[1] * gx, q[0] * gy + q[1] * gx)
    return gx, gy, z0 - level


@kernel(inline=True)
def squared_tangent(gx, gy, posting):
    """Return tan(slope)^2 from a gradient in metres per cell and the grid spacing, m."""
    tx = gx / posting
    ty = gy / posting
    return tx * tx + ty * ty


@kernel(inline=True)
def _block_above_plane(tops, here, blocks, centres, n, gx, gy):
    """Return the maximum height of block `n` above a plane through the site.

    `tops` are the maximum heights of blocks, `here` is the index of the first of sixteen sites,
    `blocks` and `centres` are the blocks' offsets from the site; (gx, gy) is the plane's gradient
    per cell.
    """
    top = load(tops, here + item(blocks, n))
    return top - item(centres, 2 * n) * gx - item(centres, 2 * n + 1) * gy


@kernel(inline=True)
def _four_blocks_above_plane(tops, here, blocks, centres, n, gx, gy):
    """Return the maximum heights of blocks `n` to n + 3 above a plane.

    Arguments are as in `_block_above_plane`.
    """
    a = _block_above_plane(tops, here, blocks, centres, n, gx, gy)
    b = _block_above_plane(tops, here, blocks, centres, n + 1, gx, gy)
    c = _block_above_plane(tops, here, blocks, centres, n + 2, gx, gy)
    d = _block_above_plane(tops, here, blocks, centres, n + 3, gx, gy)
    return a, b, c, d


@kernel(inline=True)
def _highest(four):
    a, b, c, d = four
    return lane_max(lane_max(a, b), lane_max(c, d))


@kernel(inline=True)
def _max_block_above_plane(tops, here, blocks, centres, start, stop, gx, gy):
    """Return the maximum height of blocks `start` to `stop` - 1 above a plane.

    The number of blocks is a multiple of four; the other arguments are as in `_block_above_plane`.
    """
    top = lane_fill(-FAR)
    for n in range(start, stop, 4):
        a = _block_above_plane(tops, here, blocks, centres, n, gx, gy)
        b = _block_above_plane(tops, here, blocks, centres, n + 1, gx, gy)
        c = _block_above_plane(tops, here, blocks, centres, n + 2, gx, gy)
        d = _block_above_plane(tops, here, blocks, centres, n + 3, gx, gy)
        top = lane_max(top, lane_max(lane_max(a, b), lane_max(c, d)))
    return top


AHEAD = 8  # spare rows after a tile's surroundings that may be read
PLANE_ROWS = 32  # rows of a tile in the kernels that evaluate planes


@kernel(inner=True)
def window_shape(cells, h, w):
    """Return rows and columns of the elevation window of a tile of h x w sites.

    The window includes the surroundings of `cells` (`FootprintArrays`) and spare cells that may be
    read.
    """
    return h + 2 * cells.reach + AHEAD, w + 2 * cells.reach + SIMD_WIDTH


@kernel(inner=True)
def clear(window):
    """Set unknown terrain to height 0, the reference height of the tile.

    Footprints that contain unknown terrain are marked as unobserved elsewhere.
    """
    for i in range(window.shape[0]):
        for j in range(window.shape[1]):
            if window[i, j] >= FAR:
                window[i, j] = np.float32(0.0)


@kernel(inner=True)
def terrain_under_pads(levels, window, cells, feet):
    """Write the highest terrain under a pad centred on each cell, 0 near the edge.

    `window` is the elevation, `levels` a buffer (`levels_of`), `cells` the `FootprintArrays`,
    `feet` the result.
    """
    n = cells.pad_reach
    tall, wide = window.shape
    feet[:] = np.float32(0.0)
    copy(window, levels[0])
    double(levels, cells.depth)
    over_runs(
        levels, cells.depth, cells.pad_windows, n, feet[n : tall - n, n : wide - SIMD_WIDTH - n]
    )


@kernel(inner=True)
def block_tops(window, block, out):
    """Write the maximum height of the `block` x `block` cells north-east of each cell."""
    rows, cols = window.shape
    line = np.empty(cols, np.float32)
    for i in range(rows):
        for j in range(cols):
            line[j] = window[i, j]
        for r in range(i + 1, min(i + block, rows)):
            for j in range(cols):
                line[j] = max(line[j], window[r, j])
        for j in range(cols):
            out[i, j] = line[j]
        for c in range(1, min(block, cols)):
            for j in range(cols - c):
                out[i, j] = max(out[i, j], line[j + c])


@kernel()
def flat_offsets(cells, wide):
    """Return flat index offsets of cells (row, column) in a raster of `wide` columns."""
    return cells[..., 0] * wide + cells[..., 1]


@kernel(inline=True)
def _bound_sites(tops, feet, here, legs, inverse, place, blocks, centres, first, span, posting,
                 upright):  # fmt: skip
    """Return the maximum tan(slope)^2 and a roughness bound of sixteen sites.

    `span` is half the distance between the outermost cells of a block; the other arguments are as
    in `_bound_tile` and `_block_above_plane`.
    """
    steepest = lane_fill(0.0)
    worst = lane_fill(0.0)
    for h in range(legs.shape[0]):
        for s in range(inverse.shape[1]):
            gx, gy, base = plane(feet, here, legs, inverse, place, h, s)
            top = _max_block_above_plane(
                tops, here, blocks, centres, item(first, h), item(first, h + 1), gx, gy
            )
            # A block's maximum may lie at the corner where the plane is lowest.
            rise = top + span * (lane_abs(gx) + lane_abs(gy)) - base
            square = squared_tangent(gx, gy, posting)
            steepest = lane_max(steepest, square)
            if not upright:
                rise = rise / lane_sqrt(square + np.float32(1.0))
            worst = lane_max(worst, rise)
    return steepest, worst


@kernel()
def _bound_tile(tops, feet, cells, covers, block, posting, upright, slope_out, rough_out):
    """Write the exact tan(slope) and a roughness bound of the sites of a tile.

    `tops` are the maximum heights of blocks of `block` cells, `feet` the terrain heights under a
    pad; `cells` and `covers` are the `FootprintArrays` and `PolygonBlocks` of the lander.

    With `upright`, heights are measured vertically, not along the plane's normal.
    """
    rows, cols = slope_out.shape
    wide = feet.shape[1]
    legs = flat_offsets(cells.legs, wide)
    blocks = flat_offsets(covers.corners, wide)
    inverse, place, centres, first = cells.inverse, cells.place, covers.centres, covers.first
    upper, lower = tops.reshape(tops.size), feet.reshape(feet.size)
    span = np.float32(0.5 * (block - 1))
    lanes = np.empty((2, SIMD_WIDTH), np.float32)
    for i in range(rows):
        for j in range(0, cols, SIMD_WIDTH):
            here = (i + cells.reach) * wide + cells.reach + j
            steepest, worst = _bound_sites(
                upper, lower, here, legs, inverse, place, blocks, centres, first, span, posting,
                upright,
            )  # fmt: skip
            store(lanes[0], 0, lane_sqrt(steepest))
            store(lanes[1], 0, worst)
            for k in range(min(SIMD_WIDTH, cols - j)):
                slope_out[i, j + k] = lanes[0, k]
                rough_out[i, j + k] = lanes[1, k]


@kernel(shared=True)
def bounded(share, z, middle, cells, covers, block, posting, slope_out, rough_out):
    """Write exact tan(slope) and an upper bound of roughness around each cell.

    The bound uses the maxima of blocks of `block` cells. `share` is (first tile, step between
    tiles) of one thread; `z` (rows, cols) is the elevation, `middle` the middle of its heights, m.

    Both results are invalid where a footprint contains unknown terrain or leaves the raster.
    """
    rows, cols = z.shape
    reach = cells.reach
    across, tiles = tiles_of(rows, cols, PLANE_ROWS)
    for tile in range(share[0], tiles, share[1]):
        r0, r1, c0, c1 = tile_at(tile, across, PLANE_ROWS, rows, cols)
        tall, wide = window_shape(cells, r1 - r0, c1 - c0)
        levels = levels_of(cells, tall, wide)
        window = np.empty((3, tall, wide), np.float32)
        datum = datum_of(z, middle, r0, c0, r1 - r0, c1 - c0)
        load_window(z, middle, datum, r0 - reach, c0 - reach, window[0])
        clear(window[0])
        terrain_under_pads(levels, window[0], cells, window[1])
        block_tops(window[0], block, window[2])
        _bound_tile(
            window[2], window[1], cells, covers, block, posting, False,
            slope_out[r0:r1, c0:c1], rough_out[r0:r1, c0:c1],
        )  # fmt: skip


@kernel()
def _average(high, low, middle, sigma):
    """Write mean and standard deviation of Gaussians from their 3-sigma bounds.

    `high` and `low` are the bounds (Eqs. 15 and 16 of the Gaussian DEM paper).
    """
    for i in range(high.shape[0]):
        for j in range(high.shape[1]):
            middle[i, j] = np.float32(0.5) * (high[i, j] + low[i, j])
            sigma[i, j] = (high[i, j] - low[i, j]) / np.float32(6.0)


@kernel(shared=True)
def stochastic_planes(
    share,
    mean,
    middle,
    variance,
    cells,
    covers,
    block,
    posting,
    slope_out,
    nominal,
    raised,
    leg_sigma,
):
    """Write slope, roughness bounds and leg uncertainty for cells of a Gaussian DEM.

    They are the inputs of `plane_stochastic_safety`; heights are vertical. `share` is (first tile,
    step between tiles) of one thread; `middle` is the middle of the map's heights, m.

    These are tan(slope) and a roughness bound for the means of legs and obstacles, the bound with
    all obstacles raised by 3 sigma, and the maximum standard deviation of a leg.
    """
    rows, cols = mean.shape
    reach = cells.reach
    across, tiles = tiles_of(rows, cols, PLANE_ROWS)
    for tile in range(share[0], tiles, share[1]):
        r0, r1, c0, c1 = tile_at(tile, across, PLANE_ROWS, rows, cols)
        tall, wide = window_shape(cells, r1 - r0, c1 - c0)
        levels = levels_of(cells, tall, wide)
        g = np.empty((8, tall, wide), np.float32)
        datum = datum_of(mean, middle, r0, c0, r1 - r0, c1 - c0)
        load_window(mean, middle, datum, r0 - reach, c0 - reach, g[0])
        load_variance(variance, r0 - reach, c0 - reach, g[1])
        spread_bounds(g[0], g[1], g[2], g[3])
        for n in range(2, 4):
            clear(g[n])
            terrain_under_pads(levels, g[n], cells, g[n + 2])
            block_tops(g[n], block, g[n + 4])
        _average(g[4], g[5], g[0], g[1])  # feet
        _average(g[6], g[7], g[2], g[3])  # obstacles
        for top, out in ((g[2], nominal), (g[6], raised)):
            _bound_tile(
                top, g[0], cells, covers, block, posting, True,
                slope_out[r0:r1, c0:c1], out[r0:r1, c0:c1],
            )  # fmt: skip
        copy(g[1], levels[0])
        double(levels, cells.depth)
        over_runs(levels, cells.depth, cells.stand_windows, reach, leg_sigma[r0:r1, c0:c1])
