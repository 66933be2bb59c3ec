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
    datum_of,
    fill,
    insert,
    levels_of,
    load_window,
    over_runs,
    tile_at,
    tiles_of,
)
from lunarsim.safety._plane_kernels import (
    PLANE_ROWS,
    clear,
    flat_offsets,
    plane,
    squared_tangent,
    terrain_under_pads,
    window_shape,
)
from lunarsim.safety.footprint import BLOCK

SQUARE = 8  # side of the squares of cells whose gradients the lids follow
HALF = np.float32(0.5 * (BLOCK - 1))


@kernel()
def _median(values, ascending):
    """Return the median of a small array; the mean of the middle two if even.

    `ascending` is a buffer for the sorted values.
    """
    count = 0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            insert(ascending, count, values[i, j])
            count += 1
    low, high = ascending[(count - 1) // 2], ascending[count // 2]
    return np.float32(0.5) * (low + high)


@kernel()
def slopes_at_large(z, inside, arm, out):
    """Write large-scale terrain gradients of 8 x 8 cell squares, m per cell.

    `z` (rows, cols) is the elevation, `out` (2, n, k) the gradient of each square to the east and
    north.

    The gradient is the median over a square of height differences over an `arm` to either side,
    then the median over the neighbouring squares. It follows domes and ridges and ignores rocks and
    ripples. Only heights `inside` (first and last row, first and last column) are used.
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
                    a, b = max(x - arm, left), min(x + arm, right)
                    some[0, r, c] = (z[y, b] - z[y, a]) / np.float32(max(b - a, 1))
                    a, b = max(y - arm, bottom), min(y + arm, top)
                    some[1, r, c] = (z[b, x] - z[a, x]) / np.float32(max(b - a, 1))
            for axis in range(2):
                raw[axis, i, j] = _median(some[axis], ascending)
    for axis in range(2):
        for i in range(rows):
            for j in range(cols):
                near = raw[axis, max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
                out[axis, i, j] = _median(near, ascending)


@kernel(fast=True)
def between(slopes, out):
    """Interpolate gradients of squares to the block to the north-east of each cell.

    `slopes` (n, k) is one component of the gradient at the centres of squares of SQUARE x SQUARE
    cells; `out` (rows, cols) is its value at the centre of the block of BLOCK x BLOCK cells.
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
def _lids(z, slopes, height, east, north):
    """Write height and gradient of the lid of the block north-east of each cell.

    A lid is the lowest plane of the gradient from `slopes` above all cells of the block. `height`,
    `east` and `north` (rows cols,) are the lid's height at the block's centre, m, and its gradient
    per cell.
    """
    tall, wide = z.shape
    flat = z.reshape(z.size)
    between(slopes[0], east.reshape(tall, wide))
    between(slopes[1], north.reshape(tall, wide))
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
def _lift_lids(window, here, corners, lids):
    """Write the lids of all blocks around sixteen sites, raised for gradients.

    The lid of a block is its bounding plane; its height is raised for the difference between its
    gradient and the gradient at the site. `window` is from `_prepare`, `here` the index of the
    first site, `corners` (n,) the blocks' offsets from it; block n of site k is lids[SIMD_WIDTH n +
    k].
    """
    height, east, north = window[2], window[3], window[4]
    gx, gy = load(east, here), load(north, here)
    for n in range(len(corners)):
        at = here + item(corners, n)
        slant = lane_abs(load(east, at) - gx) + lane_abs(load(north, at) - gy)
        store(lids, n * SIMD_WIDTH, load(height, at) + HALF * slant)


@kernel(inline=True)
def _lid_above_plane(lids, blocks, centres, n, gx, gy):
    """Return the height of the lid of block `n` above a plane of gradient (gx, gy).

    The plane goes through the site at height 0; heights are for sixteen neighbouring sites.
    `blocks` and `centres` are `which` and `centres` of `PolygonBlocks`.
    """
    lid = load(lids, item(blocks, n) * SIMD_WIDTH)
    return lid - item(centres, 2 * n) * gx - item(centres, 2 * n + 1) * gy


@kernel(inline=True)
def _max_in_block(z, here, wide, covers, n, gx, gy):
    """Return the maximum height of the polygon's cells in block `n` above a plane.

    The plane has the gradient (gx, gy) per cell and goes through the site at height 0. `here` is
    the index of the first of sixteen sites, `wide` the number of columns of `z`; `covers` are the
    blocks' corners and `allowed`.

    `allowed` is 0 for cells of the polygon and -FAR for the others, which is faster than a test.
    """
    corners, allowed = covers
    south, west = item(corners, 2 * n), item(corners, 2 * n + 1)
    top = lane_fill(-FAR)
    for r in range(BLOCK):
        at = here + (south + r) * wide + west
        line = lane_fill(-FAR)
        for c in range(BLOCK):
            level = load(z, at + c) + item(allowed, (n * BLOCK + r) * BLOCK + c)
            line = lane_max(line, level - np.float32(c) * gx)
        top = lane_max(top, line - np.float32(r) * gy)
    return top - np.float32(west) * gx - np.float32(south) * gy


@kernel(inline=True)
def _max_in_four_blocks(z, here, wide, covers, n, gx, gy, risen, need):
    """Compute `_max_in_block` for those of four blocks whose lids exceed `need`.

    `risen` are the heights of the lids (upper bounds) of blocks n to n + 3 above the plane; a block
    whose lid is below `need` at all sixteen sites is skipped.
    """
    a, b, c, d = risen
    top = lane_fill(-FAR)
    if any_greater(a, need):
        top = _max_in_block(z, here, wide, covers, n, gx, gy)
    if any_greater(b, need):
        top = lane_max(top, _max_in_block(z, here, wide, covers, n + 1, gx, gy))
    if any_greater(c, need):
        top = lane_max(top, _max_in_block(z, here, wide, covers, n + 2, gx, gy))
    if any_greater(d, need):
        top = lane_max(top, _max_in_block(z, here, wide, covers, n + 3, gx, gy))
    return top


@kernel(inline=True)
def _stride(headings):
    """Return an index step that visits all headings, distant headings first.

    A few distant headings approximate the roughness of a site, so that others can be skipped.
    """
    stride = max(1, round(0.382 * headings))
    while math.gcd(stride, headings) > 1:
        stride += 1
    return stride


@kernel()
def _steepest(feet, here, legs, cells, posting, out):
    """Write the maximum tan(slope) over headings and support planes of sixteen sites.

    `feet` holds the terrain height under a pad, `here` is the index of the first site, `legs` are
    the index offsets of the legs for each heading, `cells` the `FootprintArrays`.
    """
    inverse, place = cells.inverse, cells.place
    steepest = lane_fill(0.0)
    for h in range(legs.shape[0]):
        for s in range(inverse.shape[1]):
            gx, gy, _ = plane(feet, here, legs, inverse, place, h, s)
            steepest = lane_max(steepest, squared_tangent(gx, gy, posting))
    store(out, 0, lane_sqrt(steepest))


@kernel()
def _drop_steep(tangent, limit, lanes):
    """Set `lanes` to FAR for sites whose slope reaches `limit`; return if any is left.

    `tangent` and `lanes` (16,) hold tan(slope) and the skip mark of sixteen sites.
    """
    left = False
    for k in range(SIMD_WIDTH):
        if tangent[k] >= limit:
            lanes[k] = FAR
        left |= lanes[k] < FAR
    return left


@kernel()
def _write_roughness(
    window, here, wide, legs, cells, covers, posting, limit_rough, decide, start, lanes, lids,
):  # fmt: skip
    """Write the maximum roughness of sixteen sites over headings and support planes.

    lanes[0] is FAR for sites to skip, lanes[3] the margin for rounding; `lids` is from
    `_lift_lids`. Returns the heading that raised the roughness last; `start` is the first heading.
    """
    z, feet = window[0], window[1]
    ex, ey = load(window[3], here), load(window[4], here)
    inverse, place = cells.inverse, cells.place
    blocks, centres, first = covers.which, covers.centres, covers.first
    polygon = (covers.corners.reshape(covers.corners.size), covers.allowed)
    headings = legs.shape[0]
    stride = _stride(headings)
    out, margin = load(lanes[0], 0), load(lanes[3], 0)
    steepest = lane_fill(0.0)
    # Smaller values are rounding errors.
    worst = lane_fill(limit_rough) if decide else margin + margin
    last_raised = start
    for turn in range(headings):
        h = (start + turn * stride) % headings
        for s in range(inverse.shape[1]):
            gx, gy, base = plane(feet, here, legs, inverse, place, h, s)
            square = squared_tangent(gx, gy, posting)
            steepest = lane_max(steepest, square)
            stretch = lane_sqrt(square + np.float32(1.0))
            slant = lane_abs(ex - gx) + lane_abs(ey - gy)
            lowest = base + out - HALF * slant - margin
            need = lowest + worst * stretch
            for n in range(item(first, h), item(first, h + 1), 4):
                a = _lid_above_plane(lids, blocks, centres, n, gx, gy)
                b = _lid_above_plane(lids, blocks, centres, n + 1, gx, gy)
                c = _lid_above_plane(lids, blocks, centres, n + 2, gx, gy)
                d = _lid_above_plane(lids, blocks, centres, n + 3, gx, gy)
                if any_greater(lane_max(lane_max(a, b), lane_max(c, d)), need):
                    top = _max_in_four_blocks(z, here, wide, polygon, n, gx, gy, (a, b, c, d), need)
                    worst = lane_max(worst, (top - base) / stretch)
                    need = lowest + worst * stretch
                    last_raised = h
        if decide:
            out = select_ge(lane_fill(limit_rough), worst, out, lane_fill(FAR))
            if not any_greater(lane_fill(np.float32(0.5) * FAR), out):
                break
    store(lanes[1], 0, lane_max(lane_sqrt(steepest), load(lanes[1], 0)))
    store(lanes[2], 0, worst)
    return last_raised


# Relative rounding error of a few float32 operations on heights.
_ROUNDING = np.float32(2e-6)


@kernel()
def _mark(todo, size, i, first, lanes):
    """Mark which of sixteen sites to evaluate, write rounding margins; return if any.

    The sites are those of row `i` from column `first` on; `lanes` is as in `_write_roughness`.

    A site's margin depends on the heights of its footprint, which are FAR where unknown.
    """
    found = False
    for k in range(SIMD_WIDTH):
        j = first + k
        wanted = j < todo.shape[1] and todo[i, j] and size[i, j] < FAR
        lanes[0, k] = np.float32(0.0) if wanted else FAR
        lanes[3, k] = _ROUNDING * size[i, j] if wanted else np.float32(0.0)
        found |= wanted
    return found


@kernel()
def _prepare(z, middle, cells, r0, c0, window, size):
    """Fill a tile's elevation windows and the maximum height of each footprint.

    The tile begins at row `r0`, column `c0` of the raster `z`; `cells` are the `FootprintArrays`.

    `window` (5, rows, cols) becomes elevation, terrain under pads, heights and gradients of lids
    (bounding planes of blocks); `size` is FAR where a footprint contains unknown terrain or leaves
    the raster.
    """
    reach = cells.reach
    _, tall, wide = window.shape
    h, w = size.shape
    levels = levels_of(cells, tall, wide)
    datum = datum_of(z, middle, r0, c0, h, w)
    load_window(z, middle, datum, r0 - reach, c0 - reach, window[0])
    for i in range(tall):
        for j in range(wide):
            levels[0, i, j] = abs(window[0, i, j])
    fill(levels, cells)
    over_runs(levels, cells.depth, cells.leg_windows, reach, size)
    body = np.empty((h, w), np.float32)
    over_runs(levels, cells.depth, cells.body_windows, reach, body)
    for i in range(h):
        for j in range(w):
            size[i, j] = max(size[i, j], body[i, j])
    clear(window[0])
    terrain_under_pads(levels, window[0], cells, window[1])
    window[2:] = np.float32(0.0)
    slopes = np.empty((2, tall // SQUARE, wide // SQUARE), np.float32)
    rows, cols = z.shape
    inside = (
        max(reach - r0, 0),
        min(h + 2 * reach, rows - r0 + reach) - 1,
        max(reach - c0, 0),
        min(w + 2 * reach, cols - c0 + reach) - 1,
    )
    slopes_at_large(window[0], inside, max(reach // 2, 1), slopes)
    flat = window.reshape(5, tall * wide)
    _lids(window[0], slopes, flat[2], flat[3], flat[4])


@kernel()
def _exact_tile(
    window, size, todo, cells, covers, posting, limit_slope, limit_rough, decide, slope_out,
    rough_out,
):  # fmt: skip
    """Write tan(slope) and roughness of the sites `todo` of a tile.

    `window` and `size` are from `_prepare`; the other arguments are as in `exact`.
    """
    wide = window.shape[2]
    flat = window.reshape(5, window.shape[1] * wide)
    legs = flat_offsets(cells.legs, wide)
    corners = flat_offsets(covers.distinct, wide)
    lanes = np.zeros((4, SIMD_WIDTH), np.float32)
    lids = np.empty(len(corners) * SIMD_WIDTH, np.float32)
    start = 0
    for i in range(todo.shape[0]):
        for j in range(0, todo.shape[1], SIMD_WIDTH):
            if not _mark(todo, size, i, j, lanes):
                continue
            here = (i + cells.reach) * wide + cells.reach + j
            lanes[1:3] = np.float32(0.0)
            if decide:
                _steepest(flat[1], here, legs, cells, posting, lanes[1])
            if not decide or _drop_steep(lanes[1], limit_slope, lanes[0]):
                # The worst heading of one site is likely to be the worst of its neighbours.
                _lift_lids(flat, here, corners, lids)
                start = _write_roughness(
                    flat, here, wide, legs, cells, covers, posting, limit_rough, decide, start,
                    lanes, lids,
                )  # fmt: skip
            for k in range(min(SIMD_WIDTH, todo.shape[1] - j)):
                if todo[i, j + k] and size[i, j + k] < FAR:
                    min_roughness = limit_rough if decide else np.float32(2.0) * lanes[3, k]
                    slope_out[i, j + k] = lanes[1, k]
                    rough_out[i, j + k] = (
                        lanes[2, k] if lanes[2, k] > min_roughness else np.float32(0.0)
                    )


@kernel(shared=True)
def exact(
    share,
    z,
    middle,
    todo,
    cells,
    covers,
    posting,
    limit_slope,
    limit_rough,
    decide,
    slope_out,
    rough_out,
):
    """Write the maximum tan(slope) and roughness over headings and support planes.

    `share` is (first tile, step between tiles) of one thread; `z` (rows, cols) is the elevation,
    `middle` the middle of its heights; `cells` and `covers` are arrays of the lander's footprint
    (`FootprintArrays` and `PolygonBlocks`).

    Only sites `todo` with known footprints are written. A block is examined only if its lid rises
    above the plane of some site by more than that site's worst roughness so far, minus a margin for
    rounding. With `decide`, a site is finished as soon as a limit is exceeded; then only the
    comparison with the limits is valid.
    """
    rows, cols = todo.shape
    across, tiles = tiles_of(rows, cols, PLANE_ROWS)
    for tile in range(share[0], tiles, share[1]):
        r0, r1, c0, c1 = tile_at(tile, across, PLANE_ROWS, rows, cols)
        if not todo[r0:r1, c0:c1].any():
            continue
        tall, wide = window_shape(cells, r1 - r0, c1 - c0)
        window = np.empty((5, tall, wide), np.float32)
        size = np.empty((r1 - r0, c1 - c0), np.float32)
        _prepare(z, middle, cells, r0, c0, window, size)
        _exact_tile(
            window, size, todo[r0:r1, c0:c1], cells, covers, posting, limit_slope, limit_rough,
            decide, slope_out[r0:r1, c0:c1], rough_out[r0:r1, c0:c1],
        )  # fmt: skip
