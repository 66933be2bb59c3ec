# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled bounds, errors and selection of the relief's tiles."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange

# Maximum factor on the tolerated error, and thus on the distance, when looking straight down
# instead of at a grazing angle.
_STEEP_VIEW_FACTOR = 4.0


@kernel()
def _tile_extremes(z, i0, j0, i1, j1):
    """Return a tile's minimum, maximum, steepest rise per cell, and if it has no-data.

    The tile spans grid points (i0, j0) to (i1, j1) of the elevations `z`, m.
    """
    low = np.inf
    top = -np.inf
    steep = 0.0
    missing = False
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            here = np.float64(z[i, j])
            if np.isnan(here):
                missing = True
            else:
                low = min(low, here)
                top = max(top, here)
            if i < i1 and j < j1:
                z00 = np.float64(z[i, j])
                z10 = np.float64(z[i, j + 1])
                z01 = np.float64(z[i + 1, j])
                z11 = np.float64(z[i + 1, j + 1])
                lower = (z10 - z00) ** 2 + (z11 - z10) ** 2
                upper = (z11 - z01) ** 2 + (z01 - z00) ** 2
                steep = max(steep, lower)
                steep = max(steep, upper)
    return low, top, np.sqrt(steep), missing


@kernel()
def _decimation_error(z, i0, j0, i1, j1, step):
    """Return the maximum vertical error, m, of a tile drawn at reduced resolution.

    The tile spans grid points (i0, j0) to (i1, j1) of `z`; every `step`-th point is drawn.
    """
    worst = 0.0
    for ci in range(i0, i1, step):
        for cj in range(j0, j1, step):
            ei = min(ci + step, i1)
            ej = min(cj + step, j1)
            z00 = np.float64(z[ci, cj])
            z10 = np.float64(z[ci, ej])
            z01 = np.float64(z[ei, cj])
            z11 = np.float64(z[ei, ej])
            for i in range(ci, ei + 1):
                v = (i - ci) / (ei - ci)
                for j in range(cj, ej + 1):
                    u = (j - cj) / (ej - cj)
                    if u >= v:
                        flat = z00 + u * (z10 - z00) + v * (z11 - z10)
                    else:
                        flat = z00 + v * (z01 - z00) + u * (z11 - z01)
                    worst = max(worst, abs(flat - np.float64(z[i, j])))
    return worst


@kernel(parallel=True)
def tile_tables(z, side, levels, p):
    """Return minimum, maximum, steepest gradient and decimation errors of tiles.

    Tile (i, j) spans `side` cells from grid point (i * side, j * side) of the elevations `z`, m,
    with spacing `p`. The first three results are (tile rows, tile columns); a tile without any
    elevation has a minimum of inf and a maximum of -inf. The errors are (levels, tile rows, tile
    columns), m. The error at level l is the maximum vertical distance between the relief and the
    relief through every 2^l-th point; from level 1 it is infinite where an elevation is missing.
    """
    rows, cols = z.shape
    high = (rows - 2) // side + 1
    wide = (cols - 2) // side + 1
    low = np.full((high, wide), np.inf)
    top = np.full((high, wide), -np.inf)
    steep = np.zeros((high, wide))
    error = np.zeros((levels, high, wide))
    for ti in prange(high):
        for tj in range(wide):
            i0 = ti * side
            j0 = tj * side
            i1 = min(i0 + side, rows - 1)
            j1 = min(j0 + side, cols - 1)
            lowest, highest, steepest, missing = _tile_extremes(z, i0, j0, i1, j1)
            low[ti, tj] = lowest
            top[ti, tj] = highest
            steep[ti, tj] = steepest / p
            for level in range(1, levels):
                error[level, ti, tj] = (
                    np.inf if missing else _decimation_error(z, i0, j0, i1, j1, 1 << level)
                )
    return low, top, steep, error


@kernel()
def shadow_caster_blocks(z, first, side, blocks, p, sun, slope_factor):
    """Return which blocks (m, blocks^2) of tiles have faces turned away from the Sun.

    `first` (m, 2) are the first column and row of each tile of `side` cells along a side of the
    elevations `z`, m. Each tile is divided into `blocks` x `blocks` square blocks, numbered row by
    row. `p` is the grid spacing, m, and `sun` (3,) the unit vector to the Sun. A face counts if it
    rises towards the Sun by more than `slope_factor`, a factor slightly below 1, times the rise of
    the Sun's rays, or if an elevation is missing.
    """
    rows, cols = z.shape
    out = np.zeros((first.shape[0], blocks * blocks), np.bool_)
    wide = side // blocks
    limit = slope_factor * sun[2] * p
    for m in range(first.shape[0]):
        for i in range(first[m, 1], min(first[m, 1] + side, rows - 1)):
            for j in range(first[m, 0], min(first[m, 0] + side, cols - 1)):
                z00 = np.float64(z[i, j])
                z10 = np.float64(z[i, j + 1])
                z01 = np.float64(z[i + 1, j])
                z11 = np.float64(z[i + 1, j + 1])
                lower = (z10 - z00) * sun[0] + (z11 - z10) * sun[1]
                upper = (z11 - z01) * sun[0] + (z01 - z00) * sun[1]
                # Missing elevations (NaN) count as turned away.
                if not (lower <= limit and upper <= limit):
                    block = (i - first[m, 1]) // wide * blocks + (j - first[m, 0]) // wide
                    out[m, block] = True
    return out


@kernel(parallel=True)
def cell_corners(z, datum):
    """Return the heights of the corners of every cell (rows, cols, 4), float32, m.

    Heights are relative to `datum`, m, in the order SW, SE, NW, NE. Beyond the last grid point its
    value is repeated.
    """
    rows, cols = z.shape
    out = np.empty((rows, cols, 4), np.float32)
    for i in prange(rows):
        up = min(i + 1, rows - 1)
        for j in range(cols):
            right = min(j + 1, cols - 1)
            out[i, j, 0] = np.float64(z[i, j]) - datum
            out[i, j, 1] = np.float64(z[i, right]) - datum
            out[i, j, 2] = np.float64(z[up, j]) - datum
            out[i, j, 3] = np.float64(z[up, right]) - datum
    return out


@kernel()
def _coarsest_level(error, n, max_error):
    """Return the coarsest level of detail of tile n with errors up to `max_error`, m.

    `error` (levels, n) are the errors of all tiles, m.
    """
    level = 0
    while level + 1 < error.shape[0] and error[level + 1, n] <= max_error:
        level += 1
    return level


@kernel()
def choose_tiles(low, high, error, viewpoint, axes, bounds, near, tolerance, shadow_tolerance):
    """Select the visible tiles of a relief and their levels of detail for a camera.

    `low` and `high` (n, 3) are the tiles' bounding boxes, `error` (levels, n) their errors, m;
    `viewpoint` (3,) and `axes` (3, 3) are the camera's position and axes, ENU, `bounds` the
    tangents at the left, right, upper and lower border of the image, and `near` is the minimum
    depth, m. `tolerance` and `shadow_tolerance` are maximum errors per metre of distance, in the
    image and in the shadow map. Returns which tiles are visible (n,), levels (n,) for the image and
    for the shadow map, the minimum distance of a visible tile, and the corners of the bounding box
    of all visible tiles.
    """
    count = low.shape[0]
    shown = np.zeros(count, np.bool_)
    level = np.zeros(count, np.int64)
    shadow_level = np.zeros(count, np.int64)
    nearest = np.inf
    box_low = np.full(3, np.inf)
    box_high = np.full(3, -np.inf)
    for n in range(count):
        square = 0.0
        run = 0.0
        for k in range(3):
            gap = max(low[n, k] - viewpoint[k], viewpoint[k] - high[n, k], 0.0)
            square += gap * gap
            if k < 2:
                run = max(run, viewpoint[k] - low[n, k], high[n, k] - viewpoint[k])
        distance = np.sqrt(square)
        # The shader corrects the displacement by coarse tiles for steeply descending rays.
        slant = run / max(viewpoint[2] - high[n, 2], 1e-9)
        steep = min(max(_STEEP_VIEW_FACTOR / max(slant * slant, 1.0), 1.0), _STEEP_VIEW_FACTOR)
        level[n] = _coarsest_level(error, n, tolerance * steep * distance)
        shadow_level[n] = _coarsest_level(error, n, shadow_tolerance * distance)
        behind = left = right = above = below = 0
        for corner in range(8):
            e = (high[n, 0] if corner & 1 else low[n, 0]) - viewpoint[0]
            f = (high[n, 1] if corner & 2 else low[n, 1]) - viewpoint[1]
            g = (high[n, 2] if corner & 4 else low[n, 2]) - viewpoint[2]
            x = e * axes[0, 0] + f * axes[1, 0] + g * axes[2, 0]
            y = e * axes[0, 1] + f * axes[1, 1] + g * axes[2, 1]
            z = e * axes[0, 2] + f * axes[1, 2] + g * axes[2, 2]
            behind += z < near
            left += x < bounds[0] * z
            right += x > bounds[1] * z
            above += y < bounds[2] * z
            below += y > bounds[3] * z
        shown[n] = max(behind, left, right, above, below) < 8
        if shown[n]:
            nearest = min(nearest, distance)
            for k in range(3):
                box_low[k] = min(box_low[k], low[n, k])
                box_high[k] = max(box_high[k], high[n, k])
    return shown, level, shadow_level, nearest, box_low, box_high
