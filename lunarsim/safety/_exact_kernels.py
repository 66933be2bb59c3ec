# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled kernel of the exact safety map, which skips irrelevant cells.

A lid is the lowest plane of a given gradient above all cells of a block. No cell of a block whose
lid has gradient a and height t at the block's centre c rises above ``t + a (x - c)``. Above a
support plane of gradient g and height b at the site's centre, the cells rise by at most
``t - g c - b + s (|ax - gx| + |ay - gy|)``, where s is half the distance between the outermost
cells. With the terrain's gradient e at the site, the last term is at most ``s`` times
``|ax - ex| + |ay - ey| + |ex - gx| + |ey - gy|``: the first half is added once per site to the
lids' heights, the second once per plane. Lids follow smooth terrain, so that few blocks have to be
examined on any slope and curvature.

Sites lie on every `stride`-th row and column of the elevation. The columns of a window are then
grouped by their remainder modulo `stride`, so that sixteen neighbouring sites still read sixteen
consecutive values.
"""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel
from lunarsim._simd import (
    SIMD_WIDTH,
    any_greater,
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
    fill_maxima,
    insert_sorted,
    load_window,
    tile_at,
    tile_datum,
    tiles_of,
    write_footprint_max,
)
from lunarsim.safety._plane_kernels import (
    AHEAD,
    PLANE_ROWS,
    clear_unknown,
    squared_tangent,
    support_plane,
    terrain_under_pads,
)
from lunarsim.safety.footprint import BLOCK

SQUARE = 8  # side of the squares of cells whose gradients the lids follow
HALF = np.float32(0.5 * (BLOCK - 1))


@kernel()
def _median(values, ascending):
    """Return the median of the numbers in a small array `values` (rows, cols).

    An even number of values gives the mean of the middle two. `ascending` is a buffer (at least
    rows * cols,) for the sorted values.
    """
    count = 0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            insert_sorted(ascending, count, values[i, j])
            count += 1
    low, high = ascending[(count - 1) // 2], ascending[count // 2]
    return np.float32(0.5) * (low + high)


@kernel()
def large_scale_gradients(z, inside, half_baseline, out):
    """Write large-scale terrain gradients of 8 x 8 cell squares, m per cell.

    `z` is the elevation, m; `out` (2, n, k) receives the gradients of n x k squares to the east and
    to the north. The height difference per cell between points `half_baseline` cells to either side
    is filtered by the median over the square, then over the 3 x 3 squares around it, so that rocks
    and ripples have no effect. Only heights in the rows and columns `inside` (first row, last row,
    first column, last column) are used.
    """
    _, rows, cols = out.shape
    bottom, top, left, right = inside
    raw = np.empty(out.shape, np.float32)
    some = np.empty((2, SQUARE, SQUARE // 2), np.float32)
    ascending = np.empty(some.size // 2, np.float32)
    for i in range(rows):
        for j in range(cols):
            for r in range(SQUARE):
                for c in range(SQUARE // 2):
                    y = min(max(i * SQUARE + r, bottom), top)
                    x = min(max(j * SQUARE + 2 * c, left), right)
                    a, b = max(x - half_baseline, left), min(x + half_baseline, right)
                    some[0, r, c] = (z[y, b] - z[y, a]) / np.float32(max(b - a, 1))
                    a, b = max(y - half_baseline, bottom), min(y + half_baseline, top)
                    some[1, r, c] = (z[b, x] - z[a, x]) / np.float32(max(b - a, 1))
            for axis in range(2):
                raw[axis, i, j] = _median(some[axis], ascending)
    for axis in range(2):
        for i in range(rows):
            for j in range(cols):
                near = raw[axis, max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
                out[axis, i, j] = _median(near, ascending)


@kernel(fast=True)
def block_gradients(slopes, out):
    """Interpolate one gradient component from large squares to the block of each cell.

    `slopes` (n, k) are the values at the centres of squares of SQUARE x SQUARE cells. `out` (rows,
    cols) receives the values at the centre of the BLOCK x BLOCK cells to the north-east of each
    cell of the window.
    """
    rows, cols = slopes.shape
    tall, wide = out.shape
    shift = np.float32(0.5 * BLOCK / SQUARE - 0.5)
    step = np.float32(1.0 / SQUARE)
    lines = np.empty((rows, wide), np.float32)
    for j in range(wide):
        v = min(max(np.float32(j) * step + shift, np.float32(0.0)), np.float32(cols - 1))
        n = min(int(v), max(cols - 2, 0))
        m = min(n + 1, cols - 1)
        for k in range(rows):
            lines[k, j] = slopes[k, n] + (v - np.float32(n)) * (slopes[k, m] - slopes[k, n])
    for i in range(tall):
        u = min(max(np.float32(i) * step + shift, np.float32(0.0)), np.float32(rows - 1))
        n = min(int(u), max(rows - 2, 0))
        w = u - np.float32(n)
        low, high, line = lines[n], lines[min(n + 1, rows - 1)], out[i]
        for j in range(wide):
            line[j] = low[j] + w * (high[j] - low[j])


@kernel()
def _write_lids(z, slopes, height, east, north):
    """Write the bounding plane (lid) of the block to the north-east of each cell.

    The lid is the lowest plane above all cells of the block that has the large-scale terrain
    gradient, interpolated from `slopes` (2, n, k). `z` (rows, cols) is the elevation, m. `height`,
    `east` and `north` (rows * cols,) receive the lid's height at the block's centre, m, and its
    gradient per cell; `height` is not written for the last cells, whose block is incomplete.
    """
    tall, wide = z.shape
    flat = z.reshape(z.size)
    block_gradients(slopes[0], east.reshape(tall, wide))
    block_gradients(slopes[1], north.reshape(tall, wide))
    for at in range(0, z.size - (BLOCK - 1) * wide - BLOCK - SIMD_WIDTH, SIMD_WIDTH):
        gx = load(east, at)
        gy = load(north, at)
        top = lane_fill(-FAR)
        for r in range(BLOCK):
            line = at + r * wide
            best = load(flat, line)
            for c in range(1, BLOCK):
                best = lane_max(best, load(flat, line + c) - np.float32(c) * gx)
            top = lane_max(top, best - np.float32(r) * gy)
        store(height, at, top + HALF * gx + HALF * gy)


@kernel()
def _write_raised_lids(window, site, corners, lids):
    """Write height bounds of all blocks around sixteen sites into `lids`.

    The bound is the height of the block's bounding plane, raised for the difference between its
    gradient and the gradient at the site. `window` is from `_prepare_tile`, `site` the index of the
    first site, `corners` (n,) the blocks' offsets from it; the bound of block n at site k is
    lids[SIMD_WIDTH n + k].
    """
    height, east, north = window[2], window[3], window[4]
    gx, gy = load(east, site), load(north, site)
    for n in range(len(corners)):
        at = site + item(corners, n)
        slant = lane_abs(load(east, at) - gx) + lane_abs(load(north, at) - gy)
        store(lids, n * SIMD_WIDTH, load(height, at) + HALF * slant)


@kernel(inline=True)
def _lid_above_plane(lids, blocks, centres, n, gx, gy):
    """Return the height bound of block `n` minus the rise of planes to its centre.

    The planes start from height 0 at sixteen sites and have the gradients (gx, gy) per cell. `lids`
    are the height bounds from `_write_raised_lids`; `blocks` and `centres` are `corner_index` and
    `centres` of `PolygonBlocks`. The caller adds the effect of the gradients within the block.
    """
    lid = load(lids, item(blocks, n) * SIMD_WIDTH)
    return lid - item(centres, 2 * n) * gx - item(centres, 2 * n + 1) * gy


@kernel(inline=True)
def _max_in_block(z, site, columns, polygon, n, gx, gy):
    """Return the maximum terrain height in block `n` above planes at sixteen sites.

    The planes have height 0 at their sites and the gradients (gx, gy) per cell. Only cells in the
    polygon of the legs count: `polygon` is (`corners`, flattened, and `allowed`) of
    `PolygonBlocks`, and the index offsets of the blocks' columns. `z` is the flat elevation of a
    window with `columns` columns, m, and `site` the index of the first site in it.
    """
    corners, allowed, columns_of_blocks = polygon
    south, west = item(corners, 2 * n), item(corners, 2 * n + 1)
    top = lane_fill(-FAR)
    for r in range(BLOCK):
        at = site + (south + r) * columns
        line = lane_fill(-FAR)
        for c in range(BLOCK):
            level = load(z, at + item(columns_of_blocks, n * BLOCK + c))
            level = level + item(allowed, (n * BLOCK + r) * BLOCK + c)
            line = lane_max(line, level - np.float32(c) * gx)
        top = lane_max(top, line - np.float32(r) * gy)
    return top - np.float32(west) * gx - np.float32(south) * gy


@kernel(inline=True)
def _max_in_four_blocks(z, site, columns, polygon, n, gx, gy, lid_heights, threshold):
    """Return the maximum height of blocks `n` to n + 3 above planes at sixteen sites.

    The planes have height 0 at their sites and the gradients (gx, gy) per cell; the other arguments
    are those of `_max_in_block`. A block is skipped if its upper bound in `lid_heights` does not
    exceed `threshold` at any site; if all four are skipped, the result is -FAR.
    """
    a, b, c, d = lid_heights
    top = lane_fill(-FAR)
    if any_greater(a, threshold):
        top = _max_in_block(z, site, columns, polygon, n, gx, gy)
    if any_greater(b, threshold):
        top = lane_max(top, _max_in_block(z, site, columns, polygon, n + 1, gx, gy))
    if any_greater(c, threshold):
        top = lane_max(top, _max_in_block(z, site, columns, polygon, n + 2, gx, gy))
    if any_greater(d, threshold):
        top = lane_max(top, _max_in_block(z, site, columns, polygon, n + 3, gx, gy))
    return top


@kernel(inline=True)
def _stride(headings):
    """Return an index step that visits all headings, distant headings first.

    `headings` is their number. The first few headings, far apart, nearly find the maximum
    roughness of a site, so that most blocks of cells can be skipped at the other headings.
    """
    stride = max(1, round(0.382 * headings))
    while math.gcd(stride, headings) > 1:
        stride += 1
    return stride


@kernel()
def _steepest(feet, site, legs, footprint, posting, out):
    """Write the maximum tan(slope) over headings and support planes of sixteen sites.

    `out` (16,) receives the maxima. `feet` holds the terrain height under a pad centred on each
    cell, m, `site` is the index of the first site, and `legs` are the index offsets of the legs for
    each heading. `footprint` is a `FootprintArrays`, `posting` the grid spacing, m.
    """
    inverse, first_leg = footprint.inverse, footprint.first_leg
    steepest = lane_fill(0.0)
    for h in range(legs.shape[0]):
        for s in range(inverse.shape[1]):
            gx, gy, _ = support_plane(feet, site, legs, inverse, first_leg, h, s)
            steepest = lane_max(steepest, squared_tangent(gx, gy, posting))
    store(out, 0, lane_sqrt(steepest))


@kernel()
def _drop_steep(tangent, limit, skip):
    """Skip sites with tan(slope) of at least `limit`; return whether any is left.

    `tangent` (16,) is tan(slope) of each site. `skip` (16,), which is FAR for sites to skip, is set
    to FAR for these sites.
    """
    left = False
    for k in range(SIMD_WIDTH):
        if tangent[k] >= limit:
            skip[k] = FAR
        left |= skip[k] < FAR
    return left


@kernel()
def _write_roughness(
    window, site, columns, legs, footprint, polygon_blocks, polygon, posting, roughness_limit,
    classify_only, start, lanes, lids,
):  # fmt: skip
    """Write the maximum roughness of sixteen sites over headings and support planes.

    The rows of `lanes` (4, 16) are: FAR for sites to skip, else 0; tan(slope), which is raised to
    its maximum over the headings examined; roughness, m (result); and the margin for rounding, m.
    `window` is from `_prepare_tile`, `site` the index of the first site in it, `polygon` is that of
    `_max_in_block`, and `lids` are height bounds from `_write_raised_lids`. With `classify_only`,
    the roughness is at least the limit, and the loop ends when all sites exceed it. Headings are
    examined from index `start` on; the index of the heading that raised a roughness last is
    returned.
    """
    z, feet = window[0], window[1]
    ex, ey = load(window[3], site), load(window[4], site)
    inverse, first_leg = footprint.inverse, footprint.first_leg
    blocks, centres, first = (
        polygon_blocks.corner_index,
        polygon_blocks.centres,
        polygon_blocks.first,
    )
    headings = legs.shape[0]
    stride = _stride(headings)
    out, margin = load(lanes[0], 0), load(lanes[3], 0)
    steepest = lane_fill(0.0)
    # Smaller values are rounding errors.
    worst = lane_fill(roughness_limit) if classify_only else margin + margin
    last_raised = start
    for turn in range(headings):
        h = (start + turn * stride) % headings
        for s in range(inverse.shape[1]):
            gx, gy, base = support_plane(feet, site, legs, inverse, first_leg, h, s)
            square = squared_tangent(gx, gy, posting)
            steepest = lane_max(steepest, square)
            stretch = lane_sqrt(square + np.float32(1.0))
            slant = lane_abs(ex - gx) + lane_abs(ey - gy)
            lowest = base + out - HALF * slant - margin
            threshold = lowest + worst * stretch
            for n in range(item(first, h), item(first, h + 1), 4):
                a = _lid_above_plane(lids, blocks, centres, n, gx, gy)
                b = _lid_above_plane(lids, blocks, centres, n + 1, gx, gy)
                c = _lid_above_plane(lids, blocks, centres, n + 2, gx, gy)
                d = _lid_above_plane(lids, blocks, centres, n + 3, gx, gy)
                if any_greater(lane_max(lane_max(a, b), lane_max(c, d)), threshold):
                    top = _max_in_four_blocks(
                        z, site, columns, polygon, n, gx, gy, (a, b, c, d), threshold
                    )
                    worst = lane_max(worst, (top - base) / stretch)
                    threshold = lowest + worst * stretch
                    last_raised = h
        if classify_only:
            out = select_ge(lane_fill(roughness_limit), worst, out, lane_fill(FAR))
            if not any_greater(lane_fill(np.float32(0.5) * FAR), out):
                break
    store(lanes[1], 0, lane_max(lane_sqrt(steepest), load(lanes[1], 0)))
    store(lanes[2], 0, worst)
    return last_raised


# Relative rounding error of a few float32 operations on heights.
_ROUNDING = np.float32(2e-6)


@kernel()
def _select_sites(selected, footprint_max, row, first_col, lanes):
    """Write which of sixteen sites to evaluate, and rounding margins, into `lanes`.

    The sites are in row `row` of the tile from column `first_col` on. lanes[0] becomes 0 for
    `selected` sites with known footprints, else FAR. lanes[3] becomes the margin, m: it is
    proportional to `footprint_max` (rows, cols), the maximum absolute height of each site's
    footprint, FAR where unknown. The function returns whether any site is to be evaluated.
    """
    found = False
    for k in range(SIMD_WIDTH):
        j = first_col + k
        wanted = j < selected.shape[1] and selected[row, j] and footprint_max[row, j] < FAR
        lanes[0, k] = np.float32(0.0) if wanted else FAR
        lanes[3, k] = _ROUNDING * footprint_max[row, j] if wanted else np.float32(0.0)
        found |= wanted
    return found


@kernel()
def _prepare_tile(z, middle, footprint, stride, r0, c0, window, footprint_max):
    """Write the terrain windows of a tile, and the maximum height of each footprint.

    The tile begins at row `r0`, column `c0` of the raster `z`, m, whose heights have the middle
    `middle`; its sites are `stride` cells apart. `window` (5, rows, cols) becomes elevation,
    terrain under pads, and height and gradient (2) of each block's bounding plane, with columns
    grouped by `_group_columns`. Heights are relative to the tile's reference height; unknown
    terrain is 0. `footprint_max` (sites of the tile) becomes the maximum absolute height, FAR where
    a footprint contains unknown terrain or leaves the raster.
    """
    margin = site_margin(footprint, stride)
    _, tall, wide = window.shape
    h, w = (
        stride * (footprint_max.shape[0] - 1) + 1,
        stride * (footprint_max.shape[1] - 1) + 1,
    )
    levels = allocate_levels(footprint, tall, wide)
    datum = tile_datum(z, middle, r0, c0, h, w)
    load_window(z, middle, datum, r0 - margin, c0 - margin, window[0])
    for i in range(tall):
        for j in range(wide):
            levels[0, i, j] = abs(window[0, i, j])
    fill_maxima(levels, footprint)
    leg = np.empty((len(footprint_max), w), np.float32)
    body = np.empty((len(footprint_max), w), np.float32)
    write_footprint_max(levels, footprint.depth, footprint.leg_windows, margin, stride, leg)
    write_footprint_max(levels, footprint.depth, footprint.body_windows, margin, stride, body)
    for i in range(footprint_max.shape[0]):
        for j in range(footprint_max.shape[1]):
            footprint_max[i, j] = max(leg[i, j * stride], body[i, j * stride])
    clear_unknown(window[0])
    terrain_under_pads(levels, window[0], footprint, window[1])
    window[2:] = np.float32(0.0)
    slopes = np.empty((2, tall // SQUARE, wide // SQUARE), np.float32)
    rows, cols = z.shape
    inside = (
        max(margin - r0, 0),
        min(h + 2 * margin, rows - r0 + margin) - 1,
        max(margin - c0, 0),
        min(w + 2 * margin, cols - c0 + margin) - 1,
    )
    large_scale_gradients(window[0], inside, max(footprint.reach // 2, 1), slopes)
    flat = window.reshape(5, tall * wide)
    _write_lids(window[0], slopes, flat[2], flat[3], flat[4])
    if stride > 1:
        _group_columns(window, stride)


@kernel()
def site_margin(footprint, stride):
    """Return the number of cells around the sites of a tile in its window.

    It is a multiple of `stride`.
    """
    return (footprint.reach + stride - 1) // stride * stride


@kernel()
def _group_columns(window, stride):
    """Sort the columns of a window by their remainder modulo `stride`.

    The window is (layers, rows, cols). Column c moves to
    ``(c % stride) (cols / stride) + c // stride``, as in `_column_offset`.
    """
    layers, tall, wide = window.shape
    line = np.empty(wide, np.float32)
    for n in range(layers):
        for i in range(tall):
            at = 0
            for k in range(stride):
                for j in range(k, wide, stride):
                    line[at] = window[n, i, j]
                    at += 1
            for j in range(wide):
                window[n, i, j] = line[j]


@kernel(inline=True)
def _column_offset(column, columns, stride):
    """Return the index offset of a relative column in a window of grouped columns."""
    return (column % stride) * (columns // stride) + column // stride


@kernel()
def _grouped_offsets(cells, columns, stride):
    """Return index offsets (n,) of relative cells (row, column) in such a window."""
    out = np.empty(len(cells), np.int64)
    for n in range(len(cells)):
        out[n] = cells[n, 0] * columns + _column_offset(cells[n, 1], columns, stride)
    return out


@kernel()
def _exact_tile(
    window, footprint_max, selected, footprint, polygon_blocks, stride, posting, slope_limit,
    roughness_limit, classify_only, slope_out, rough_out,
):  # fmt: skip
    """Write the maximum tan(slope) and roughness of the `selected` sites of a tile.

    The maximum is over headings and support planes; `slope_out` and `rough_out` (sites of the tile)
    receive it. Sites that are not selected or have unknown terrain in their footprint are not
    written. With `classify_only`, a site is finished when a limit is exceeded. `window` and
    `footprint_max` are from `_prepare_tile`; `footprint` and `polygon_blocks` are `FootprintArrays`
    and `PolygonBlocks`, `posting` is the grid spacing, m; limits are those of `exact`.
    """
    columns = window.shape[2]
    flat = window.reshape(5, window.shape[1] * columns)
    shape = footprint.legs.shape
    legs = _grouped_offsets(footprint.legs.reshape(-1, 2), columns, stride).reshape(shape[:2])
    corners = _grouped_offsets(polygon_blocks.distinct, columns, stride)
    blocks = polygon_blocks.corners
    columns_of_blocks = np.empty(len(blocks) * BLOCK, np.int64)
    for n in range(len(blocks)):
        for c in range(BLOCK):
            offset = _column_offset(blocks[n, 1] + c, columns, stride)
            columns_of_blocks[n * BLOCK + c] = offset
    polygon = (blocks.reshape(blocks.size), polygon_blocks.allowed, columns_of_blocks)
    lanes = np.zeros((4, SIMD_WIDTH), np.float32)
    lids = np.empty(len(corners) * SIMD_WIDTH, np.float32)
    margin = site_margin(footprint, stride)
    start = 0
    for i in range(selected.shape[0]):
        for j in range(0, selected.shape[1], SIMD_WIDTH):
            if not _select_sites(selected, footprint_max, i, j, lanes):
                continue
            site = (margin + stride * i) * columns + margin // stride + j
            lanes[1:3] = np.float32(0.0)
            if classify_only:
                _steepest(flat[1], site, legs, footprint, posting, lanes[1])
            if not classify_only or _drop_steep(lanes[1], slope_limit, lanes[0]):
                # The worst heading of one site is likely to be the worst of its neighbours.
                _write_raised_lids(flat, site, corners, lids)
                start = _write_roughness(
                    flat, site, columns, legs, footprint, polygon_blocks, polygon, posting,
                    roughness_limit, classify_only, start, lanes, lids,
                )  # fmt: skip
            for k in range(min(SIMD_WIDTH, selected.shape[1] - j)):
                if selected[i, j + k] and footprint_max[i, j + k] < FAR:
                    min_roughness = (
                        roughness_limit if classify_only else np.float32(2.0) * lanes[3, k]
                    )
                    slope_out[i, j + k] = lanes[1, k]
                    rough_out[i, j + k] = (
                        lanes[2, k] if lanes[2, k] > min_roughness else np.float32(0.0)
                    )


@kernel(shared=True)
def exact(
    thread_slice,
    z,
    middle,
    selected,
    footprint,
    polygon_blocks,
    stride,
    posting,
    slope_limit,
    roughness_limit,
    classify_only,
    slope_out,
    rough_out,
):
    """Write the maximum tan(slope) and roughness over headings and support planes.

    The sites (rows, cols) lie on every `stride`-th row and column of the elevation `z`, m, from the
    first on; `middle` is the middle of its heights. `slope_out` and `rough_out` (rows, cols)
    receive tan(slope) and roughness (m) of the `selected` sites (rows, cols) whose footprints are
    known; other sites are not written. `footprint` and `polygon_blocks` are `FootprintArrays` and
    `PolygonBlocks`; `slope_limit` is a tangent, `roughness_limit` is in m.
    With `classify_only`, a site is finished as soon as a limit is exceeded; then only the
    comparison with the limits is valid. `thread_slice` is (first tile, step between tiles) of one
    thread.
    """
    rows, cols = selected.shape
    across, tiles = tiles_of(rows, cols, PLANE_ROWS)
    for tile in range(thread_slice[0], tiles, thread_slice[1]):
        r0, r1, c0, c1 = tile_at(tile, across, PLANE_ROWS, rows, cols)
        if not selected[r0:r1, c0:c1].any():
            continue
        margin = site_margin(footprint, stride)
        tall = stride * (r1 - r0 - 1) + 1 + 2 * margin + AHEAD
        wide = stride * (c1 - c0) + 2 * margin + SIMD_WIDTH * stride
        window = np.empty((5, tall, wide), np.float32)
        footprint_max = np.empty((r1 - r0, c1 - c0), np.float32)
        _prepare_tile(z, middle, footprint, stride, stride * r0, stride * c0, window, footprint_max)
        _exact_tile(
            window, footprint_max, selected[r0:r1, c0:c1], footprint, polygon_blocks, stride,
            posting, slope_limit, roughness_limit, classify_only, slope_out[r0:r1, c0:c1],
            rough_out[r0:r1, c0:c1],
        )  # fmt: skip
