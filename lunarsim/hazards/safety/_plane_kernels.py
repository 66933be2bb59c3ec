"""Compiled kernels that go through the support planes of every heading: exact and bounded.

Rasters are float32 (rows, cols) without NaN.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.hazards.safety._kernels import FAR

_STRETCH = 128  # sites of a row that a thread takes at once


@kernel(finite=True)
def _site_planes(feet, offsets, inverse, place, legs, gx, gy, base):
    """Write gradient (a cell) and height at the centre of all support planes of one site.

    `feet` starts at the lowest leg cell of the site; lane s * headings + h is plane s of heading
    h. `legs` is scratch for the heights of the legs (4, headings).
    """
    headings = offsets.shape[1]
    for n in range(offsets.shape[0]):
        own = offsets[n]
        heights = legs[n]
        for h in range(headings):
            heights[h] = feet[own[h]]
    za = legs[0]
    zb = legs[1]
    zc = legs[2]
    if offsets.shape[0] == 3:
        for h in range(headings):
            u = zb[h] - za[h]
            v = zc[h] - za[h]
            x = inverse[0, 0, 0, h] * u + inverse[0, 0, 1, h] * v
            y = inverse[0, 0, 2, h] * u + inverse[0, 0, 3, h] * v
            gx[h] = x
            gy[h] = y
            base[h] = za[h] - y * place[0, 0, 0, h] - x * place[0, 0, 1, h]
        return
    zd = legs[3]
    for s in range(2):
        m = inverse[s]
        q = place[s]
        for h in range(headings):
            first = za[h] + zc[h] >= zb[h] + zd[h]
            # Plane 0 stands on legs a b c or a b d, plane 1 on a c d or b c d.
            if s == 0:
                z0 = za[h]
                u = zb[h] - z0
                v = zc[h] - z0 if first else zd[h] - z0
            else:
                z0 = za[h] if first else zb[h]
                u = zc[h] - z0
                v = zd[h] - z0
            xu = m[0, 0, h] if first else m[1, 0, h]
            xv = m[0, 1, h] if first else m[1, 1, h]
            yu = m[0, 2, h] if first else m[1, 2, h]
            yv = m[0, 3, h] if first else m[1, 3, h]
            row = q[0, 0, h] if first else q[1, 0, h]
            col = q[0, 1, h] if first else q[1, 1, h]
            x = xu * u + xv * v
            y = yu * u + yv * v
            gx[s * headings + h] = x
            gy[s * headings + h] = y
            base[s * headings + h] = z0 - y * row - x * col


@kernel(finite=True)
def _prepare(gx, gy, base, posting, span, stretch, slack, top):
    """Write each lane's 1 / cos(slope) and slack of a block; return the largest tan(slope)^2."""
    steepest = np.float32(0.0)
    for lane in range(gx.size):
        tx = gx[lane] / posting
        ty = gy[lane] / posting
        square = tx * tx + ty * ty
        stretch[lane] = square
        slack[lane] = span * (abs(gx[lane]) + abs(gy[lane]))
        top[lane] = base[lane]
    for lane in range(gx.size):
        steepest = max(steepest, stretch[lane])
        stretch[lane] = np.sqrt(np.float32(1.0) + stretch[lane])
    return steepest


@kernel(finite=True)
def _worst(top, base, stretch, worst):
    """Return the largest distance of a top above its plane, or `worst` if larger."""
    for lane in range(top.size):
        worst = max(worst, (top[lane] - base[lane]) / stretch[lane])
    return worst


@kernel(parallel=True, finite=True)
def exact(
    z, feet, blocks, todo, offsets, lowest, inverse, place, windows, window_allowed, cells,
    cell_allowed, block, posting, reach, limit_slope, limit_rough, decide, slope_out, rough_out,
):  # fmt: skip
    """Write tan(slope) and roughness, the worst over headings and admissible planes.

    The planes of one site are SIMD lanes. `blocks` holds the highest ground in block x block
    cells north-east of each cell; a block (a row of `windows`) is opened only if its top, put at
    the corner where a plane is lowest, rises above some plane by more than the worst roughness
    found so far. Allowed is 0 where the polygon of a lane's heading holds the cell or touches
    the block, else far below any ground. With `decide` a site is left as soon as a limit is
    passed: only the comparison with the limits is then meant.
    """
    rows, cols = z.shape
    lanes = window_allowed.shape[1]
    flat = feet.reshape(rows * cols)
    span = np.float32(0.5 * (block - 1))
    for i in prange(reach, rows - reach):
        work = np.empty((7, lanes), np.float32)
        most = np.empty(windows.shape[0], np.float32)
        legs = np.empty((offsets.shape[0], offsets.shape[1]), np.float32)
        gx = work[0]
        gy = work[1]
        base = work[2]
        stretch = work[3]
        threshold = work[4]
        top = work[5]
        slack = work[6]
        for j in range(reach, cols - reach):
            if not todo[i, j]:
                continue
            near = flat[i * cols + j + lowest :]
            _site_planes(near, offsets, inverse, place, legs, gx, gy, base)
            steepest = _prepare(gx, gy, base, posting, span, stretch, slack, top)
            slope_out[i, j] = np.sqrt(steepest)
            worst = np.float32(0.0)
            if decide:
                if slope_out[i, j] >= limit_slope:
                    continue
                worst = limit_rough
            for lane in range(lanes):
                threshold[lane] = base[lane] + worst * stretch[lane]
            # One plane that is nowhere above any lane's, less what they can differ: most blocks
            # fall to this one comparison.
            low = base[0]
            x0 = gx[0]
            x1 = gx[0]
            y0 = gy[0]
            y1 = gy[0]
            for lane in range(lanes):
                low = min(low, base[lane])
                x0 = min(x0, gx[lane])
                x1 = max(x1, gx[lane])
                y0 = min(y0, gy[lane])
                y1 = max(y1, gy[lane])
            mx = np.float32(0.5) * (x0 + x1)
            my = np.float32(0.5) * (y0 + y1)
            ex = x1 - mx
            ey = y1 - my
            widest = span * (abs(mx) + ex + abs(my) + ey)
            first = 0
            for n in range(windows.shape[0]):
                height = blocks[i + windows[n, 0], j + windows[n, 1]]
                cx = np.float32(windows[n, 1]) + span
                cy = np.float32(windows[n, 0]) + span
                most[n] = height - cx * mx - cy * my + abs(cx) * ex + abs(cy) * ey
                if most[n] > most[first]:
                    first = n
            # The block that stands out most goes first: it spares the others.
            for turn in range(-1, windows.shape[0]):
                n = first if turn < 0 else turn
                if most[n] + widest <= low + worst or turn == first:
                    continue
                height = blocks[i + windows[n, 0], j + windows[n, 1]]
                cx = np.float32(windows[n, 1]) + span
                cy = np.float32(windows[n, 0]) + span
                allowed = window_allowed[n]
                count = 0
                for lane in range(lanes):
                    v = height - cx * gx[lane] - cy * gy[lane] + slack[lane] + allowed[lane]
                    count += 1 if v > threshold[lane] else 0
                if count == 0:
                    continue
                for m in range(windows[n, 2], windows[n, 3]):
                    r = cells[m, 0]
                    c = cells[m, 1]
                    level = z[i + r, j + c]
                    dx = np.float32(c)
                    dy = np.float32(r)
                    if level - dx * mx - dy * my + abs(dx) * ex + abs(dy) * ey <= low + worst:
                        continue
                    within = cell_allowed[m]
                    for lane in range(lanes):
                        v = level - dx * gx[lane] - dy * gy[lane] + within[lane]
                        old = top[lane]
                        top[lane] = v if v > old else old
                higher = _worst(top, base, stretch, worst)
                if higher > worst:
                    worst = higher
                    if decide:
                        break
                    for lane in range(lanes):
                        threshold[lane] = base[lane] + worst * stretch[lane]
            # A decision starts at the limit; only what rises above it counts.
            rough_out[i, j] = worst if not decide or worst > limit_rough else np.float32(0.0)


@kernel(parallel=True)
def block_tops(z, block, out):
    """Write the highest ground in block x block cells to the north-east of each cell."""
    rows, cols = z.shape
    for i in prange(rows):
        for j in range(cols):
            best = z[i, j]
            for r in range(i, min(i + block, rows)):
                for c in range(j, min(j + block, cols)):
                    best = max(best, z[r, c])
            out[i, j] = best


@kernel(finite=True)
def _plane(p0, p1, p2, z0, z1, z2, gx, gy, base):
    """Write gradient (a cell) and height at the centre of the planes through three legs.

    p*: cells (row, column) of the legs; z*: heights under them, a lane for each site.
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


@kernel(finite=True)
def _lift_four(s0, s1, s2, s3, place, gx, gy, top):
    """Raise `top` to the heights of four blocks above the planes; place: (column, row) each."""
    x0 = place[0, 0]
    y0 = place[0, 1]
    x1 = place[1, 0]
    y1 = place[1, 1]
    x2 = place[2, 0]
    y2 = place[2, 1]
    x3 = place[3, 0]
    y3 = place[3, 1]
    for j in range(top.size):
        gxj = gx[j]
        gyj = gy[j]
        v0 = s0[j] - x0 * gxj - y0 * gyj
        v1 = s1[j] - x1 * gxj - y1 * gyj
        v2 = s2[j] - x2 * gxj - y2 * gyj
        v3 = s3[j] - x3 * gxj - y3 * gyj
        v0 = v0 if v0 > v1 else v1
        v2 = v2 if v2 > v3 else v3
        v0 = v0 if v0 > v2 else v2
        t = top[j]
        top[j] = v0 if v0 > t else t


@kernel(parallel=True, finite=True)
def bounded(blocks, feet, legs, covers, first_cover, block, reach, posting, slope_out, rough_out):
    """Write tan(slope), exact, and a bound of the roughness from the tops of blocks of cells.

    Stretches of a row run in parallel, sites of a stretch in SIMD lanes. `covers` (n, 2) lists
    the blocks (row, column) that cover the polygon of heading h, from first_cover[h], in
    multiples of four.
    """
    rows, cols = blocks.shape
    headings, count, _ = legs.shape
    planes = 2 if count == 4 else 1
    span = np.float32(0.5 * (block - 1))
    across = (cols - 2 * reach + _STRETCH - 1) // _STRETCH
    for task in prange((rows - 2 * reach) * across):
        i = reach + task // across
        c0 = reach + (task % across) * _STRETCH
        width = min(_STRETCH, cols - reach - c0)
        work = np.empty((9, width), np.float32)
        place = np.empty((4, 2), np.float32)
        gx = work[0]
        gy = work[1]
        base = work[2]
        other_gx = work[3]
        other_gy = work[4]
        other_base = work[5]
        top = work[6]
        slope = work[7]
        rough = work[8]
        slope[:] = np.float32(0.0)
        rough[:] = np.float32(0.0)
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
                for n in range(first_cover[h], first_cover[h + 1], 4):
                    for k in range(4):
                        place[k, 0] = np.float32(covers[n + k, 1]) + span
                        place[k, 1] = np.float32(covers[n + k, 0]) + span
                    j0 = c0 + covers[n, 1]
                    j1 = c0 + covers[n + 1, 1]
                    j2 = c0 + covers[n + 2, 1]
                    j3 = c0 + covers[n + 3, 1]
                    _lift_four(
                        blocks[i + covers[n, 0], j0 : j0 + width],
                        blocks[i + covers[n + 1, 0], j1 : j1 + width],
                        blocks[i + covers[n + 2, 0], j2 : j2 + width],
                        blocks[i + covers[n + 3, 0], j3 : j3 + width],
                        place,
                        gx,
                        gy,
                        top,
                    )
                for j in range(width):
                    tx = gx[j] / step
                    ty = gy[j] / step
                    square = tx * tx + ty * ty
                    # A block's top may stand at its corner where the plane is lowest.
                    height = top[j] + span * (abs(gx[j]) + abs(gy[j])) - base[j]
                    height = height / np.sqrt(np.float32(1.0) + square)
                    old = slope[j]
                    slope[j] = square if square > old else old
                    old = rough[j]
                    rough[j] = height if height > old else old
        for j in range(width):
            slope_out[i, c0 + j] = np.sqrt(slope[j])
            rough_out[i, c0 + j] = rough[j]
