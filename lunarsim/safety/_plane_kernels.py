"""Compiled kernels that go through the support planes of every heading: exact and bounded.

Rasters are flat (rows * cols + LANES,), float32, without NaN; sixteen neighbouring sites of a row
are taken at a time. Lanes beyond the last site read what follows and are dropped.
"""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim._lanes import (
    LANES,
    any_above,
    item,
    larger,
    load,
    magnitude,
    root,
    spread,
    store,
    where_above,
)
from lunarsim.safety._kernels import FAR
from lunarsim.safety.footprint import BLOCK


@kernel(inline=True)
def _plane(feet, here, legs, inverse, place, h, s):
    """Return gradient (a cell) and height at the centre of plane `s` of heading `h`.

    `feet` holds the ground under a pad; `here` is the index of the first site.
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
    # The higher diagonal carries: plane 0 stands on legs a b c or a b d, plane 1 on a c d or b c d.
    one = za + zc
    two = zb + zd
    if s == 0:
        z0 = za
        u = zb - z0
        v = where_above(one, two, zc, zd) - z0
    else:
        z0 = where_above(one, two, za, zb)
        u = zc - z0
        v = zd - z0
    m = inverse[h, s, 0]
    n = inverse[h, s, 1]
    p = place[h, s, 0]
    q = place[h, s, 1]
    gx = where_above(one, two, m[0] * u + m[1] * v, n[0] * u + n[1] * v)
    gy = where_above(one, two, m[2] * u + m[3] * v, n[2] * u + n[3] * v)
    level = where_above(one, two, p[0] * gy + p[1] * gx, q[0] * gy + q[1] * gx)
    return gx, gy, z0 - level


@kernel(inline=True)
def _squared_tangent(gx, gy, posting):
    tx = gx / posting
    ty = gy / posting
    return tx * tx + ty * ty


@kernel(inline=True)
def _risen(tops, here, blocks, centres, n, gx, gy):
    """Return the top of block `n` above a plane through the site."""
    top = load(tops, here + item(blocks, n))
    return top - item(centres, 2 * n) * gx - item(centres, 2 * n + 1) * gy


@kernel(inline=True)
def _four_risen(tops, here, blocks, centres, n, gx, gy):
    """Return the tops of blocks `n` to n + 3 above a plane through the site."""
    a = _risen(tops, here, blocks, centres, n, gx, gy)
    b = _risen(tops, here, blocks, centres, n + 1, gx, gy)
    c = _risen(tops, here, blocks, centres, n + 2, gx, gy)
    d = _risen(tops, here, blocks, centres, n + 3, gx, gy)
    return a, b, c, d


@kernel(inline=True)
def _highest(four):
    a, b, c, d = four
    return larger(larger(a, b), larger(c, d))


@kernel(inline=True)
def _open(z, here, cols, corners, allowed, n, gx, gy):
    """Return the highest of the cells that a polygon holds of block `n`, above a plane.

    `allowed` is 0 for these cells and -FAR for the others; a test for each would cost more.
    """
    south, west = item(corners, 2 * n), item(corners, 2 * n + 1)
    top = spread(-FAR)
    for r in range(BLOCK):
        at = here + (south + r) * cols + west
        line = spread(-FAR)
        for c in range(BLOCK):
            level = load(z, at + c) + item(allowed, (n * BLOCK + r) * BLOCK + c)
            line = larger(line, level - np.float32(c) * gx)
        top = larger(top, line - np.float32(r) * gy)
    return top - np.float32(west) * gx - np.float32(south) * gy


@kernel(inline=True)
def _steepest(feet, here, legs, inverse, place, planes, posting):
    """Return the largest tan(slope)^2 over headings and planes."""
    steepest = spread(0.0)
    for h in range(legs.shape[0]):
        for s in range(planes):
            gx, gy, _ = _plane(feet, here, legs, inverse, place, h, s)
            steepest = larger(steepest, _squared_tangent(gx, gy, posting))
    return steepest


@kernel(inline=True)
def _mark(todo, i, first, cols, reach, lanes):
    """Set `lanes` to 0 at the sites to do, else FAR; return whether there are any."""
    found = False
    for k in range(LANES):
        j = first + k
        wanted = j < cols - reach and todo[i, j]
        lanes[k] = np.float32(0.0) if wanted else FAR
        found |= wanted
    return found


@kernel(inline=True)
def _drop_steep(steepest, limit, lanes):
    """Set `lanes` to FAR where the slope is at its limit; return whether any is left."""
    left = False
    for k in range(LANES):
        if np.sqrt(steepest[k]) >= limit:
            lanes[k] = FAR
        left |= lanes[k] < FAR
    return left


@kernel(inline=True)
def _open_four(z, here, cols, corners, allowed, n, gx, gy, risen, need):
    """Return what `_open` does for those of blocks `n` to n + 3 that rise above what is needed."""
    q0, q1, q2, q3 = risen
    top = spread(-FAR)
    if any_above(q0, need):
        top = _open(z, here, cols, corners, allowed, n, gx, gy)
    if any_above(q1, need):
        top = larger(top, _open(z, here, cols, corners, allowed, n + 1, gx, gy))
    if any_above(q2, need):
        top = larger(top, _open(z, here, cols, corners, allowed, n + 2, gx, gy))
    if any_above(q3, need):
        top = larger(top, _open(z, here, cols, corners, allowed, n + 3, gx, gy))
    return top


@kernel(inline=True)
def _stride(headings):
    """Return by how much to go on so that every heading gets its turn, those far apart first.

    They soon show about how rough a site is, which spares the others.
    """
    stride = max(1, round(0.382 * headings))
    while math.gcd(stride, headings) > 1:
        stride += 1
    return stride


@kernel(inline=True)
def _write_sites(lanes, todo, i, first, beyond, least, slope_out, rough_out):
    """Write the sites to do out of lanes of slopes and roughnesses, none of which is `beyond`."""
    for k in range(min(LANES, beyond - first)):
        if todo[i, first + k]:
            slope_out[i, first + k] = lanes[1, k]
            rough_out[i, first + k] = lanes[2, k] if lanes[2, k] > least else np.float32(0.0)


@kernel(parallel=True)
def exact(
    z, feet, tops, todo, legs, inverse, place, blocks, centres, corners, allowed, first,
    posting, reach, margin, limit_slope, limit_rough, decide, slope_out, rough_out,
):  # fmt: skip
    """Write tan(slope) and roughness, the worst over headings and admissible planes.

    `tops` holds the highest ground in each block of cells. The blocks first[h] to first[h + 1]
    cover the polygon of heading h; one is opened only if its top, put at the corner where the
    plane is lowest, rises above the plane of some site by more than that site's worst roughness so
    far, less a `margin` for rounding. With `decide` a site is left as soon as a limit is passed:
    only the comparison with the limits is then meant.
    """
    rows, cols = todo.shape
    headings = legs.shape[0]
    planes = inverse.shape[1]
    stride = _stride(headings)
    span = np.float32(0.5 * (BLOCK - 1))
    for i in prange(reach, rows - reach):
        lanes = np.empty((3, LANES), np.float32)
        start = 0
        for j in range(reach, cols - reach, LANES):
            if not _mark(todo, i, j, cols, reach, lanes[0]):
                continue
            here = i * cols + j
            steepest = spread(0.0)
            # Less is rounding, and no roughness.
            least = np.float32(2.0) * margin
            if decide:
                steepest = _steepest(feet, here, legs, inverse, place, planes, posting)
                store(lanes[1], 0, steepest)
                least = limit_rough
            going = not decide or _drop_steep(lanes[1], limit_slope, lanes[0])
            out = load(lanes[0], 0)
            worst = spread(least)
            last_raised = start
            for turn in range(headings if going else 0):
                h = (start + turn * stride) % headings
                for s in range(planes):
                    gx, gy, base = _plane(feet, here, legs, inverse, place, h, s)
                    square = _squared_tangent(gx, gy, posting)
                    steepest = larger(steepest, square)
                    stretch = root(square + np.float32(1.0))
                    lowest = base + out - span * (magnitude(gx) + magnitude(gy)) - margin
                    need = lowest + worst * stretch
                    for n in range(item(first, h), item(first, h + 1), 4):
                        q = _four_risen(tops, here, blocks, centres, n, gx, gy)
                        if any_above(_highest(q), need):
                            top = _open_four(z, here, cols, corners, allowed, n, gx, gy, q, need)
                            worst = larger(worst, (top - base) / stretch)
                            need = lowest + worst * stretch
                            last_raised = h
                if decide:
                    out = where_above(spread(limit_rough), worst, out, spread(FAR))
                    if not any_above(spread(np.float32(0.5) * FAR), out):
                        break
            # The heading that was worst here is likely to be so next door, and spares the others.
            start = last_raised
            store(lanes[1], 0, root(steepest))
            store(lanes[2], 0, worst)
            _write_sites(lanes, todo, i, j, cols - reach, least, slope_out, rough_out)


@kernel(parallel=True)
def bounded(tops, shape, feet, legs, inverse, place, blocks, centres, first, block, reach, posting,
            slope_out, rough_out):  # fmt: skip
    """Write tan(slope), exact, and a bound of the roughness from the tops of blocks of cells.

    The number of blocks of each heading is a multiple of four.
    """
    rows, cols = shape
    planes = inverse.shape[1]
    span = np.float32(0.5 * (block - 1))
    for i in prange(reach, rows - reach):
        lanes = np.empty((2, LANES), np.float32)
        for j in range(reach, cols - reach, LANES):
            here = i * cols + j
            steepest = spread(0.0)
            worst = spread(0.0)
            for h in range(legs.shape[0]):
                for s in range(planes):
                    gx, gy, base = _plane(feet, here, legs, inverse, place, h, s)
                    top = spread(-FAR)
                    for n in range(item(first, h), item(first, h + 1), 4):
                        four = _four_risen(tops, here, blocks, centres, n, gx, gy)
                        top = larger(top, _highest(four))
                    # A block's top may stand at its corner where the plane is lowest.
                    top = top + span * (magnitude(gx) + magnitude(gy))
                    square = _squared_tangent(gx, gy, posting)
                    steepest = larger(steepest, square)
                    worst = larger(worst, (top - base) / root(square + np.float32(1.0)))
            store(lanes[0], 0, root(steepest))
            store(lanes[1], 0, worst)
            for k in range(min(LANES, cols - reach - j)):
                slope_out[i, j + k] = lanes[0, k]
                rough_out[i, j + k] = lanes[1, k]


@kernel(parallel=True)
def block_tops(z, block, out):
    """Write the highest ground in block x block cells to the north-east of each cell.

    z (rows, cols); out flat, see above.
    """
    rows, cols = z.shape
    for i in prange(rows):
        line = np.empty(cols, np.float32)
        for j in range(cols):
            line[j] = z[i, j]
        for r in range(i + 1, min(i + block, rows)):
            for j in range(cols):
                line[j] = max(line[j], z[r, j])
        for j in range(cols):
            best = line[j]
            for c in range(j + 1, min(j + block, cols)):
                best = max(best, line[c])
            out[i * cols + j] = best
