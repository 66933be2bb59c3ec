# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for tiles of terrain about which an image is lit.

If nothing dark lies in the image box that contains all core points of a tile's positions, all their
shadows would fall on lit terrain. The box follows from interval arithmetic: values between nodes
are bilinear, so they lie between minimum and maximum of the tile's corners.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange

# Columns of a node as the camera has it: sharpness, reach, the place off the camera, east, north,
# up, the same along the sensor's axes, and along these the core's points, x of all, then y, then z.
SHARP, FAR, E, N, H, X, Y, Z, CORE = range(9)
# Maximum lateral shift of the terrain in the image, in radii of a rock, that is searched.
MOST_STEPS = 16
# Sides of a tile, positions, and of a block of pixels with a common largest rock.
_TILE, _BLOCK = 8, 4
# Boxes of up to this many pixels are tested pixel by pixel.
_FEW = 48
# Bound of the rounding error of image points, pixels.
ROUNDING = 0.01
# Number of parts over which neighbouring rows are distributed.
_SPREAD = 16


@kernel()
def spread(rows):
    """Return the row numbers in an order that balances the work of parallel threads.

    Terrain in view lies in some of the rows only, so each part gets rows from everywhere.
    """
    order = np.empty(rows, np.int64)
    n = 0
    for first in range(_SPREAD):
        for row in range(first, rows, _SPREAD):
            order[n] = row
            n += 1
    return order


@kernel(parallel=True)
def largest_of_blocks(shadow_of, high, wide):
    """Return the largest rock whose shadow each pixel block may be (rows, cols), m.

    `shadow_of` is the radius of that rock for each pixel, row by row, m, negative for tracked
    rocks. `high` and `wide` are the size of the image, pixels.
    """
    rows, cols = (high + _BLOCK - 1) // _BLOCK, (wide + _BLOCK - 1) // _BLOCK
    out = np.empty((rows, cols), np.float32)
    for row in prange(rows):
        for col in range(cols):
            most = np.float32(0.0)
            for i in range(row * _BLOCK, min((row + 1) * _BLOCK, high)):
                for j in range(col * _BLOCK, min((col + 1) * _BLOCK, wide)):
                    most = max(most, abs(shadow_of[i * wide + j]))
            out[row, col] = most
    return out


@kernel(exact=True)
def tiles_of(every):
    """Return the number of tiles along one side of a square of nodes.

    `every` is the number of positions between two nodes.
    """
    return max(1, every // _TILE)


@kernel(exact=True)
def tile_at(place, node, every):
    """Return the index of the tile that contains a position, along one axis.

    `place` is the index of the position, `node` that of the node before it, and `every` the number
    of positions between two nodes.
    """
    tiles = tiles_of(every)
    return node * tiles + min((place - node * every) * tiles // every, tiles - 1)


@kernel(allocates=False)
def _corners(low, high, nodes, i, j, every, tile_row, tile_col):
    """Compute minimum and maximum of all node columns over the corners of a tile.

    `low` and `high` (columns,) receive the results; False is returned if a value is not finite. The
    tile (`tile_row`, `tile_col`) is part of the square at node (`i`, `j`), which has `every`
    positions along a side. `nodes` are those of the coarse grid in sensor axes (rows, cols,
    columns).
    """
    tiles = tiles_of(every)
    low[:], high[:] = np.inf, -np.inf
    for a in range(2):
        # A tile begins with its first position.
        v = min(-(-(tile_row + a) * every // tiles) / every, 1.0)
        for b in range(2):
            u = min(-(-(tile_col + b) * every // tiles) / every, 1.0)
            for k in range(len(low)):
                west = nodes[i, j, k] + v * (nodes[i + 1, j, k] - nodes[i, j, k])
                east = nodes[i, j + 1, k] + v * (nodes[i + 1, j + 1, k] - nodes[i, j + 1, k])
                value = west + u * (east - west)
                if not np.isfinite(value):
                    return False
                low[k], high[k] = min(low[k], value), max(high[k], value)
    return True


@kernel(exact=True)
def _extent(low, high, first, points):
    """Return the range of all test points of a tile's shadows along one axis.

    `low` and `high` (columns,) are the limits from `_corners`. `first` is the column of the first
    point and `points` their number.
    """
    least, most, none = np.inf, -np.inf, 0.0
    for k in range(first, first + points):
        least, most = min(least, low[k]), max(most, high[k])
        # `min` and `max` may skip NaN; adding it makes the bounds NaN, and no test succeeds.
        none += 0.0 * low[k]
    return least + none, most + none


@kernel(exact=True)
def extents(low, high):
    """Return the ranges of all test points of a tile's shadows in sensor axes.

    The result is x, y and z, each minimum and maximum, for rocks with a half axis of 1, relative to
    their position. `low` and `high` (columns,) are the limits of the tile.
    """
    points = (len(low) - CORE) // 3
    x0, x1 = _extent(low, high, CORE, points)
    y0, y1 = _extent(low, high, CORE + points, points)
    z0, z1 = _extent(low, high, CORE + 2 * points, points)
    return x0, x1, y0, y1, z0, z1


@kernel(exact=True)
def _axis(low, high, at, extent_low, extent_high, radius, least, most, up):
    """Return the range of test points along a sensor axis for a range of heights.

    `low` and `high` (columns,) are the limits of the tile, `at` is the column of the axis.
    `extent_low` and `extent_high` are the range of the points for a half axis of 1, `radius` is the
    half axis, m. `least` and `most` are the limits of the terrain rise, m, and `up` is the
    component of the vertical along the axis.
    """
    one, other = least * up, most * up
    first = low[at] + radius * extent_low + min(one, other)
    return first, high[at] + radius * extent_high + max(one, other)


@kernel(exact=True)
def _pixels(low, high, near, far, focal, centre):
    """Return the range of pixels for a range of coordinates and depths.

    `low` and `high` limit the coordinate, `near` and `far` the depth, m; `focal` and `centre` are
    focal length and principal point, pixels.
    """
    least = focal * (low / near if low < 0.0 else low / far) + centre - ROUNDING
    most = focal * (high / near if high > 0.0 else high / far) + centre + ROUNDING
    return least, most


@kernel(exact=True)
def _nothing_dark(first_row, last_row, first_col, last_col, radius, wide, shadow_of, blocks):
    """Return whether no pixel of a box may be in the shadow of a rock of a radius.

    `radius` is in m. `shadow_of` is the radius of the largest possible rock for each pixel, row by
    row, and `blocks` its maximum over blocks of pixels, m. Large boxes are tested by blocks, which
    is conservative. The box extends from `first_row` to `last_row` and from `first_col` to
    `last_col`; `wide` is the width of the image, pixels.
    """
    if (last_row - first_row + 1) * (last_col - first_col + 1) <= _FEW:
        for row in range(first_row, last_row + 1):
            for col in range(first_col, last_col + 1):
                if abs(shadow_of[row * wide + col]) >= radius:
                    return False
    else:
        for row in range(first_row // _BLOCK, last_row // _BLOCK + 1):
            for col in range(first_col // _BLOCK, last_col // _BLOCK + 1):
                if blocks[row, col] >= radius:
                    return False
    return True


@kernel(exact=True)
def lit_within(low, high, extent, least, most, up, radius, lens, high_px, wide, shadow_of, blocks):
    """Return whether shadows between two terrain heights fall on lit pixels in view.

    `low` and `high` (columns,) are the limits of the tile's nodes and `extent` the result of
    `extents`. `least` and `most` are the limits of the terrain rise, m, `up` (3,) the vertical in
    sensor axes, and `radius` the radius of the rock, m. `lens` is (fx, fy, cx, cy); `high_px` and
    `wide` are the size of the image. `shadow_of` and `blocks` are the largest rocks for pixels and
    blocks.
    """
    fx, fy, cx, cy = lens
    near, far = _axis(low, high, Z, extent[4], extent[5], radius, least, most, up[2])
    if not near > 0.0:
        return False
    x0, x1 = _axis(low, high, X, extent[0], extent[1], radius, least, most, up[0])
    y0, y1 = _axis(low, high, Y, extent[2], extent[3], radius, least, most, up[1])
    left, right = _pixels(x0, x1, near, far, fx, cx)
    upper, lower = _pixels(y0, y1, near, far, fy, cy)
    if not (left >= 0.0 and upper >= 0.0 and right <= wide - 1 and lower <= high_px - 1):
        return False
    return _nothing_dark(
        np.int32(upper + 0.5), np.int32(lower + 0.5), np.int32(left + 0.5), np.int32(right + 0.5),
        radius, wide, shadow_of, blocks,
    )  # fmt: skip


@kernel(allocates=False, inner=True)
def all_lit(low, high, extent, up, radius, lens, high_px, wide, shadow_of, blocks):
    """Return whether all shadows of rocks in a tile fall on lit pixels in view.

    This holds for all possible terrain heights, within the search limit of `_dark_elsewhere`. The
    arguments are those of `lit_within`.
    """
    by = max(abs(low[FAR]), abs(high[FAR]))
    east, north = max(abs(low[E]), abs(high[E])), max(abs(low[N]), abs(high[N]))
    lateral = by * np.sqrt(east * east + north * north) / max(-high[H], 1e-9)
    if not lateral < MOST_STEPS * radius:
        return False
    return lit_within(
        low, high, extent, -by, by, up, radius, lens, high_px, wide, shadow_of, blocks
    )


@kernel(parallel=True)
def lit_tiles(nodes, every, radii, up, lens, height, width, shadow_of, blocks):
    """Find the tiles of terrain in which all shadows of a rock size are on lit pixels.

    Parameters
    ----------
    nodes
        Nodes of the coarse grid in sensor axes (rows, cols, columns).
    every
        Number of positions between two nodes.
    radii
        Radii of the rocks (sizes,), m.
    up
        Vertical in sensor axes (3,).
    lens, height, width
        fx, fy, cx, cy, and size of the image, pixels.
    shadow_of, blocks
        Radius of the largest rock whose shadow each pixel may be, row by row, m, and its maximum
        over blocks of pixels, from `largest_of_blocks`.

    Returns
    -------
    lit
        Whether all shadows fall on lit pixels (tile rows, tile cols, sizes).
    """
    tiles = tiles_of(every)
    rows, cols = (nodes.shape[0] - 1) * tiles, (nodes.shape[1] - 1) * tiles
    out = np.zeros((rows, cols, len(radii)), np.bool_)
    order = spread(rows)
    for k in prange(rows):
        row = order[k]
        low, high = np.empty(nodes.shape[2]), np.empty(nodes.shape[2])
        for col in range(cols):
            i, j = row // tiles, col // tiles
            if _corners(low, high, nodes, i, j, every, row - i * tiles, col - j * tiles):
                extent = extents(low, high)
                for s in range(len(radii)):
                    out[row, col, s] = all_lit(
                        low, high, extent, up, radii[s], lens, height, width, shadow_of, blocks
                    )
    return out
