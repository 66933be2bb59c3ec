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
    allocate_levels,
    copy_window,
    fill_row_maxima,
    load_variance,
    load_window,
    spread_bounds,
    tile_at,
    tile_datum,
    tiles_of,
    write_footprint_max,
)


@kernel(inline=True)
def support_plane(feet, site, legs, inverse, first_leg, heading, plane):
    """Return gradient (per cell) and centre height of a support plane at 16 sites.

    The results are the gradients to the east and to the north and the height, m. The legs stand on
    `feet`, the terrain height under a pad centred on each cell. `site` is the index of the first
    site, `legs` are the index offsets of the legs by heading; `inverse` and `first_leg` are those
    of `FootprintArrays`. `heading` is an index; `plane` is 0 or, for four legs, 0 or 1.
    """
    za = load(feet, site + legs[heading, 0])
    zb = load(feet, site + legs[heading, 1])
    zc = load(feet, site + legs[heading, 2])
    if legs.shape[1] == 3:
        m = inverse[heading, 0, 0]
        q = first_leg[heading, 0, 0]
        u = zb - za
        v = zc - za
        gx = m[0] * u + m[1] * v
        gy = m[2] * u + m[3] * v
        return gx, gy, za - q[0] * gy - q[1] * gx
    zd = load(feet, site + legs[heading, 3])
    # The higher diagonal carries the lander: plane 0 on a b c or a b d, plane 1 on a c d or b c d.
    one = za + zc
    two = zb + zd
    if plane == 0:
        z0 = za
        u = zb - z0
        v = select_ge(one, two, zc, zd) - z0
    else:
        z0 = select_ge(one, two, za, zb)
        u = zc - z0
        v = zd - z0
    m = inverse[heading, plane, 0]
    n = inverse[heading, plane, 1]
    p = first_leg[heading, plane, 0]
    q = first_leg[heading, plane, 1]
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
def _block_above_plane(tops, site, blocks, centres, n, gx, gy):
    """Return the maximum height of block `n` minus the plane's height at its centre.

    There is one plane for each of sixteen sites, with height 0 at the site and the gradient (gx,
    gy) per cell. `tops` are the maximum terrain heights of blocks, `site` is the index of the first
    site, and `blocks` and `centres` are the offsets of the blocks' corners and centres from a site.
    """
    top = load(tops, site + item(blocks, n))
    return top - item(centres, 2 * n) * gx - item(centres, 2 * n + 1) * gy


@kernel(inline=True)
def _max_block_above_plane(tops, site, blocks, centres, start, stop, gx, gy):
    """Return the maximum height above planes of blocks `start` to `stop` - 1.

    The height of a block is its maximum terrain height minus the height of the plane at its centre.
    The arguments are as in `_block_above_plane`.
    """
    top = lane_fill(-FAR)
    for n in range(start, stop, 4):
        a = _block_above_plane(tops, site, blocks, centres, n, gx, gy)
        b = _block_above_plane(tops, site, blocks, centres, n + 1, gx, gy)
        c = _block_above_plane(tops, site, blocks, centres, n + 2, gx, gy)
        d = _block_above_plane(tops, site, blocks, centres, n + 3, gx, gy)
        top = lane_max(top, lane_max(lane_max(a, b), lane_max(c, d)))
    return top


AHEAD = 8  # spare rows after a tile's surroundings that may be read
PLANE_ROWS = 32  # rows of a tile in the kernels that evaluate planes


@kernel(inner=True)
def window_shape(footprint, rows, cols):
    """Return rows and columns of the elevation window of a tile of sites.

    The tile has `rows` x `cols` sites. The window adds the reach of the `footprint` on each side,
    and spare rows and columns at the end, because kernels load sixteen neighbouring cells at once.
    """
    return rows + 2 * footprint.reach + AHEAD, cols + 2 * footprint.reach + SIMD_WIDTH


@kernel(inner=True)
def clear_unknown(window):
    """Set unknown terrain (FAR) in a window to height 0, the tile's reference height.

    Other functions mark footprints that contain unknown terrain as unobserved.
    """
    for i in range(window.shape[0]):
        for j in range(window.shape[1]):
            if window[i, j] >= FAR:
                window[i, j] = np.float32(0.0)


@kernel(inner=True)
def terrain_under_pads(levels, window, footprint, feet):
    """Write the highest terrain under a pad centred on each cell, 0 near the edge.

    `window` (rows, cols) is the elevation, m; `feet` (rows, cols) receives the result; `levels` is
    a buffer from `allocate_levels`, which is overwritten.
    """
    n = footprint.pad_reach
    tall, wide = window.shape
    feet[:] = np.float32(0.0)
    copy_window(window, levels[0])
    fill_row_maxima(levels, footprint.depth)
    write_footprint_max(
        levels,
        footprint.depth,
        footprint.pad_windows,
        n,
        1,
        feet[n : tall - n, n : wide - SIMD_WIDTH - n],
    )


@kernel(inner=True)
def block_tops(window, block, out):
    """Write the maximum height of the block of cells north-east of each cell to `out`.

    A block has `block` x `block` cells and includes the cell; it ends at the window's edges.
    """
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
def flat_offsets(cells, columns):
    """Return flat index offsets of cells (row, column) in a raster of given width."""
    return cells[..., 0] * columns + cells[..., 1]


@kernel(inline=True)
def _bound_sites(
    tops, feet, site, legs, inverse, first_leg, blocks, centres, first, half_width, posting,
    vertical,
):  # fmt: skip
    """Return maximum tan(slope)^2 and an upper bound of roughness at sixteen sites.

    The maxima are over headings and support planes. `tops` are the maximum terrain heights of
    blocks of cells, `feet` the terrain heights under a pad, m, and `site` is the index of the first
    site. `legs`, `blocks` and `centres` are offsets of legs, block corners and block centres from a
    site; `first` (headings + 1,) is the index of the first block of each heading. `inverse` and
    `first_leg` are those of `FootprintArrays`. `half_width` is half the distance between the
    outermost cells of a block, cells. With `vertical`, roughness is vertical, otherwise along the
    plane's normal.
    """
    steepest = lane_fill(0.0)
    worst = lane_fill(0.0)
    for h in range(legs.shape[0]):
        for s in range(inverse.shape[1]):
            gx, gy, base = support_plane(feet, site, legs, inverse, first_leg, h, s)
            top = _max_block_above_plane(
                tops, site, blocks, centres, item(first, h), item(first, h + 1), gx, gy
            )
            # A block's maximum may lie at the corner where the plane is lowest.
            rise = top + half_width * (lane_abs(gx) + lane_abs(gy)) - base
            square = squared_tangent(gx, gy, posting)
            steepest = lane_max(steepest, square)
            if not vertical:
                rise = rise / lane_sqrt(square + np.float32(1.0))
            worst = lane_max(worst, rise)
    return steepest, worst


@kernel()
def _bound_tile(
    tops, feet, footprint, polygon_blocks, block, posting, vertical, slope_out, rough_out
):
    """Write the exact tan(slope) and an upper bound of roughness of a tile's sites.

    `slope_out` and `rough_out` (sites of the tile) receive the results. `tops` are the maximum
    heights of the blocks of `block` x `block` cells north-east of each cell, `feet` the terrain
    heights under a pad centred on each cell, m. With `vertical`, roughness is measured vertically,
    otherwise along the plane's normal.
    """
    rows, cols = slope_out.shape
    wide = feet.shape[1]
    legs = flat_offsets(footprint.legs, wide)
    blocks = flat_offsets(polygon_blocks.corners, wide)
    inverse, first_leg, centres, first = (
        footprint.inverse,
        footprint.first_leg,
        polygon_blocks.centres,
        polygon_blocks.first,
    )
    upper, lower = tops.reshape(tops.size), feet.reshape(feet.size)
    half_width = np.float32(0.5 * (block - 1))
    lanes = np.empty((2, SIMD_WIDTH), np.float32)
    for i in range(rows):
        for j in range(0, cols, SIMD_WIDTH):
            site = (i + footprint.reach) * wide + footprint.reach + j
            steepest, worst = _bound_sites(
                upper, lower, site, legs, inverse, first_leg, blocks, centres, first, half_width,
                posting, vertical,
            )  # fmt: skip
            store(lanes[0], 0, lane_sqrt(steepest))
            store(lanes[1], 0, worst)
            for k in range(min(SIMD_WIDTH, cols - j)):
                slope_out[i, j + k] = lanes[0, k]
                rough_out[i, j + k] = lanes[1, k]


@kernel(shared=True)
def bounded(
    thread_slice, z, middle, footprint, polygon_blocks, block, posting, slope_out, rough_out
):
    """Write exact tan(slope) and an upper bound of roughness around each cell.

    `slope_out` and `rough_out` (rows, cols) receive the results, which are invalid where a
    footprint contains unknown terrain or leaves the raster. The bound, m, uses the maximum heights
    of blocks of `block` x `block` cells. `z` (rows, cols) is the elevation, `middle` the middle of
    its heights, m. `thread_slice` is (first tile, step between tiles) of one thread.
    """
    rows, cols = z.shape
    reach = footprint.reach
    across, tiles = tiles_of(rows, cols, PLANE_ROWS)
    for tile in range(thread_slice[0], tiles, thread_slice[1]):
        r0, r1, c0, c1 = tile_at(tile, across, PLANE_ROWS, rows, cols)
        tall, wide = window_shape(footprint, r1 - r0, c1 - c0)
        levels = allocate_levels(footprint, tall, wide)
        window = np.empty((3, tall, wide), np.float32)
        datum = tile_datum(z, middle, r0, c0, r1 - r0, c1 - c0)
        load_window(z, middle, datum, r0 - reach, c0 - reach, window[0])
        clear_unknown(window[0])
        terrain_under_pads(levels, window[0], footprint, window[1])
        block_tops(window[0], block, window[2])
        _bound_tile(
            window[2], window[1], footprint, polygon_blocks, block, posting, False,
            slope_out[r0:r1, c0:c1], rough_out[r0:r1, c0:c1],
        )  # fmt: skip


@kernel()
def _gaussian_from_bounds(high, low, mean, sigma):
    """Write `mean` and `sigma` of Gaussians with 3-sigma bounds `high` and `low`."""
    for i in range(high.shape[0]):
        for j in range(high.shape[1]):
            mean[i, j] = np.float32(0.5) * (high[i, j] + low[i, j])
            sigma[i, j] = (high[i, j] - low[i, j]) / np.float32(6.0)


@kernel(shared=True)
def stochastic_planes(
    thread_slice,
    mean,
    middle,
    variance,
    footprint,
    polygon_blocks,
    block,
    posting,
    slope_out,
    nominal,
    raised,
    leg_sigma,
):
    """Write slope, roughness bounds and leg uncertainty for cells of a Gaussian DEM.

    The last four arguments (rows, cols) are written: `slope_out` is tan(slope) and `nominal` a
    roughness bound, m, for the mean heights of legs and obstacles; `raised` is the bound, m, with
    all obstacles raised by 3 sigma; `leg_sigma` is the maximum standard deviation of a leg's
    height, m. An obstacle is the highest terrain in a block of `block` x `block` cells. `mean` (m)
    and `variance` (m^2) are the elevation, `middle` is the middle of the map's heights, m, and
    `thread_slice` is (first tile, step between tiles) of one thread.
    """
    rows, cols = mean.shape
    reach = footprint.reach
    across, tiles = tiles_of(rows, cols, PLANE_ROWS)
    for tile in range(thread_slice[0], tiles, thread_slice[1]):
        r0, r1, c0, c1 = tile_at(tile, across, PLANE_ROWS, rows, cols)
        tall, wide = window_shape(footprint, r1 - r0, c1 - c0)
        levels = allocate_levels(footprint, tall, wide)
        g = np.empty((8, tall, wide), np.float32)
        datum = tile_datum(mean, middle, r0, c0, r1 - r0, c1 - c0)
        load_window(mean, middle, datum, r0 - reach, c0 - reach, g[0])
        load_variance(variance, r0 - reach, c0 - reach, g[1])
        spread_bounds(g[0], g[1], g[2], g[3])
        for n in range(2, 4):
            clear_unknown(g[n])
            terrain_under_pads(levels, g[n], footprint, g[n + 2])
            block_tops(g[n], block, g[n + 4])
        _gaussian_from_bounds(g[4], g[5], g[0], g[1])  # feet
        _gaussian_from_bounds(g[6], g[7], g[2], g[3])  # obstacles
        for top, out in ((g[2], nominal), (g[6], raised)):
            _bound_tile(
                top, g[0], footprint, polygon_blocks, block, posting, True,
                slope_out[r0:r1, c0:c1], out[r0:r1, c0:c1],
            )  # fmt: skip
        copy_window(g[1], levels[0])
        fill_row_maxima(levels, footprint.depth)
        write_footprint_max(
            levels, footprint.depth, footprint.stand_windows, reach, 1, leg_sigma[r0:r1, c0:c1]
        )
