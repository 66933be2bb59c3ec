# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for tiles of terrain about which an image is lit.

If nothing dark lies in the image box that contains all core points of a tile's positions, all their
shadows would fall on lit terrain. The box follows from interval arithmetic: values between nodes
are bilinear, so they lie between minimum and maximum of the tile's corners.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange

# Columns of a node in sensor axes: sharpness; possible error of the terrain height; offset from the
# camera to the east, north and up; the same offset in sensor axes; test points, first x, then y, z.
SHARP, FAR, E, N, H, X, Y, Z, CORE = range(9)
# Maximum lateral shift of the terrain in the image, in radii of a rock, that is searched.
MAX_STEPS = 16
# Sides of a tile, positions, and of a block of pixels with a common largest rock.
_TILE, _BLOCK = 8, 4
# Boxes of up to this many pixels are tested pixel by pixel.
_FEW = 48
# Bound of the rounding error of image points, pixels.
ROUNDING = 0.01
# Number of parts over which neighbouring rows are distributed.
_SPREAD = 16


@kernel()
def balanced_row_order(row_count):
    """Return the row numbers in an order that balances the work of parallel threads.

    Terrain in view lies in some of the rows only, so each thread gets rows from everywhere.
    """
    order = np.empty(row_count, np.int64)
    n = 0
    for first in range(_SPREAD):
        for row in range(first, row_count, _SPREAD):
            order[n] = row
            n += 1
    return order


@kernel(parallel=True)
def max_radius_of_blocks(radius_of_pixel, image_height, image_width):
    """Return the radius of the largest rock that may shade each pixel block, m.

    The result has shape (block rows, block cols). `radius_of_pixel` is the radius for each pixel,
    row by row, m, negative for tracked rocks; signs are ignored.
    """
    rows, cols = (image_height + _BLOCK - 1) // _BLOCK, (image_width + _BLOCK - 1) // _BLOCK
    out = np.empty((rows, cols), np.float32)
    for row in prange(rows):
        for col in range(cols):
            most = np.float32(0.0)
            for i in range(row * _BLOCK, min((row + 1) * _BLOCK, image_height)):
                for j in range(col * _BLOCK, min((col + 1) * _BLOCK, image_width)):
                    most = max(most, abs(radius_of_pixel[i * image_width + j]))
            out[row, col] = most
    return out


@kernel(exact=True)
def tiles_per_square(node_spacing):
    """Return the number of tiles along one side of a square of nodes.

    `node_spacing` is the number of positions between two nodes.
    """
    return max(1, node_spacing // _TILE)


@kernel(exact=True)
def tile_index(position, node, node_spacing):
    """Return the index of the tile that contains a position, along one axis.

    `position` is the index of the position, `node` that of the node before it, and `node_spacing`
    the number of positions between two nodes.
    """
    tiles = tiles_per_square(node_spacing)
    return node * tiles + min((position - node * node_spacing) * tiles // node_spacing, tiles - 1)


@kernel(allocates=False)
def _node_range(low, high, nodes, i, j, node_spacing, tile_row, tile_col):
    """Compute minimum and maximum of all node columns over the corners of a tile.

    `low` and `high` (columns,) receive the results; False is returned if a value is not finite. The
    tile (`tile_row`, `tile_col`) is part of the square at node (`i`, `j`), which has `node_spacing`
    positions along a side. `nodes` (rows, cols, columns) are in sensor axes.
    """
    tiles = tiles_per_square(node_spacing)
    low[:], high[:] = np.inf, -np.inf
    for a in range(2):
        # A tile begins with its first position.
        v = min(-(-(tile_row + a) * node_spacing // tiles) / node_spacing, 1.0)
        for b in range(2):
            u = min(-(-(tile_col + b) * node_spacing // tiles) / node_spacing, 1.0)
            for k in range(len(low)):
                west = nodes[i, j, k] + v * (nodes[i + 1, j, k] - nodes[i, j, k])
                east = nodes[i, j + 1, k] + v * (nodes[i + 1, j + 1, k] - nodes[i, j + 1, k])
                value = west + u * (east - west)
                if not np.isfinite(value):
                    return False
                low[k], high[k] = min(low[k], value), max(high[k], value)
    return True


@kernel(exact=True)
def _column_range(low, high, first, points):
    """Return the range of all test points of a tile's shadows along one axis.

    `low` and `high` (columns,) are the results of `_node_range`. `first` is the column of the first
    point and `points` their number.
    """
    least, most, none = np.inf, -np.inf, 0.0
    for k in range(first, first + points):
        least, most = min(least, low[k]), max(most, high[k])
        # `min` and `max` may skip NaN; adding it makes the bounds NaN, and no test succeeds.
        none += 0.0 * low[k]
    return least + none, most + none


@kernel(exact=True)
def shadow_extents(low, high):
    """Return the ranges of all test points of a tile's shadows in sensor axes.

    The result is x, y and z, each minimum and maximum, for rocks with a half axis of 1, relative to
    their position. `low` and `high` (columns,) are the minimum and maximum of the tile's nodes.
    """
    points = (len(low) - CORE) // 3
    x0, x1 = _column_range(low, high, CORE, points)
    y0, y1 = _column_range(low, high, CORE + points, points)
    z0, z1 = _column_range(low, high, CORE + 2 * points, points)
    return x0, x1, y0, y1, z0, z1


@kernel(exact=True)
def _axis_range(low, high, column, extent_low, extent_high, radius, min_rise, max_rise, up):
    """Return the range of test points along a sensor axis for a range of heights.

    `low` and `high` (columns,) are the minimum and maximum of the tile's nodes, and `column` is
    that of the axis. `extent_low` and `extent_high` are the range of the points for a half axis of
    1, and `radius` is the half axis, m. `min_rise` and `max_rise` limit the error of the terrain
    height, m, and `up` is the component of the vertical along the axis.
    """
    one, other = min_rise * up, max_rise * up
    first = low[column] + radius * extent_low + min(one, other)
    return first, high[column] + radius * extent_high + max(one, other)


@kernel(exact=True)
def _pixel_range(low, high, near, far, focal, centre):
    """Return the range of pixels for a range of coordinates and depths.

    `low` and `high` limit the coordinate, `near` and `far` the depth, m; `focal` and `centre` are
    focal length and principal point, pixels.
    """
    least = focal * (low / near if low < 0.0 else low / far) + centre - ROUNDING
    most = focal * (high / near if high > 0.0 else high / far) + centre + ROUNDING
    return least, most


@kernel(exact=True)
def _is_box_lit(
    first_row, last_row, first_col, last_col, radius, image_width, radius_of_pixel, radius_of_block
):
    """Return whether a rock of a radius (m) can shade none of the pixels of a box.

    The box extends from `first_row` to `last_row` and from `first_col` to `last_col`. The largest
    rock that may shade a pixel is `radius_of_pixel`, m, row by row; `radius_of_block` is its
    maximum over blocks of pixels. Large boxes are tested by blocks, which is conservative.
    """
    if (last_row - first_row + 1) * (last_col - first_col + 1) <= _FEW:
        for row in range(first_row, last_row + 1):
            for col in range(first_col, last_col + 1):
                if abs(radius_of_pixel[row * image_width + col]) >= radius:
                    return False
    else:
        for row in range(first_row // _BLOCK, last_row // _BLOCK + 1):
            for col in range(first_col // _BLOCK, last_col // _BLOCK + 1):
                if radius_of_block[row, col] >= radius:
                    return False
    return True


@kernel(exact=True)
def is_lit_between(
    low, high, shadow_extent, min_rise, max_rise, up, radius, intrinsics, image_height,
    image_width, radius_of_pixel, radius_of_block,
):  # fmt: skip
    """Return whether shadows between two terrain heights fall on lit pixels in view.

    The shadows are those of a rock at any position in a tile. The result is False if one may be out
    of view or if a pixel in the box around all of them may be dark.

    `low` and `high` (columns,) are the minimum and maximum of the tile's nodes and `shadow_extent`
    the result of `shadow_extents`. `min_rise` and `max_rise` limit the error of the terrain height,
    m, `up` (3,) is the vertical in sensor axes, and `radius` the radius of the rock, m.
    `intrinsics` is (fx, fy, cx, cy). `radius_of_pixel` and `radius_of_block` are the radii of the
    largest rocks that may shade pixels and blocks.
    """
    fx, fy, cx, cy = intrinsics
    near, far = _axis_range(
        low, high, Z, shadow_extent[4], shadow_extent[5], radius, min_rise, max_rise, up[2]
    )
    if not near > 0.0:
        return False
    x0, x1 = _axis_range(
        low, high, X, shadow_extent[0], shadow_extent[1], radius, min_rise, max_rise, up[0]
    )
    y0, y1 = _axis_range(
        low, high, Y, shadow_extent[2], shadow_extent[3], radius, min_rise, max_rise, up[1]
    )
    left, right = _pixel_range(x0, x1, near, far, fx, cx)
    upper, lower = _pixel_range(y0, y1, near, far, fy, cy)
    if not (
        left >= 0.0 and upper >= 0.0 and right <= image_width - 1 and lower <= image_height - 1
    ):
        return False
    return _is_box_lit(
        np.int32(upper + 0.5), np.int32(lower + 0.5), np.int32(left + 0.5), np.int32(right + 0.5),
        radius, image_width, radius_of_pixel, radius_of_block,
    )  # fmt: skip


@kernel(allocates=False, inner=True)
def is_tile_lit(
    low, high, shadow_extent, up, radius, intrinsics, image_height, image_width,
    radius_of_pixel, radius_of_block,
):  # fmt: skip
    """Return whether all shadows of rocks in a tile fall on lit pixels in view.

    This must hold for all possible terrain heights. The result is False if the possible height
    error displaces shadows by MAX_STEPS radii of the rock or more. `low` and `high` (columns,) are
    the minimum and maximum of the tile's nodes, `shadow_extent` is from `shadow_extents`, and
    `radius` is that of the rock, m; the other arguments are those of `is_lit_between`.
    """
    max_rise = max(abs(low[FAR]), abs(high[FAR]))
    east, north = max(abs(low[E]), abs(high[E])), max(abs(low[N]), abs(high[N]))
    lateral = max_rise * np.sqrt(east * east + north * north) / max(-high[H], 1e-9)
    if not lateral < MAX_STEPS * radius:
        return False
    return is_lit_between(
        low, high, shadow_extent, -max_rise, max_rise, up, radius, intrinsics, image_height,
        image_width, radius_of_pixel, radius_of_block,
    )  # fmt: skip


@kernel(parallel=True)
def lit_tiles(
    nodes, node_spacing, radii, up, intrinsics, image_height, image_width, radius_of_pixel,
    radius_of_block,
):  # fmt: skip
    """Find the tiles in which all shadows of a rock size fall on lit pixels.

    Tiles of about 8 x 8 positions divide the squares between the nodes of the coarse grid. The
    result (tile rows, tile cols, sizes) is True if a rock of the size at any position of the tile
    casts its shadow on lit pixels in view. `nodes` (rows, cols, columns) are the nodes in sensor
    axes, with `node_spacing` positions between two of them. `radii` (sizes,), m, are those of the
    rocks. The other arguments are those of `is_lit_between`.
    """
    tiles = tiles_per_square(node_spacing)
    rows, cols = (nodes.shape[0] - 1) * tiles, (nodes.shape[1] - 1) * tiles
    out = np.zeros((rows, cols, len(radii)), np.bool_)
    order = balanced_row_order(rows)
    for k in prange(rows):
        row = order[k]
        low, high = np.empty(nodes.shape[2]), np.empty(nodes.shape[2])
        for col in range(cols):
            i, j = row // tiles, col // tiles
            if _node_range(low, high, nodes, i, j, node_spacing, row - i * tiles, col - j * tiles):
                shadow_extent = shadow_extents(low, high)
                for s in range(len(radii)):
                    out[row, col, s] = is_tile_lit(
                        low, high, shadow_extent, up, radii[s], intrinsics, image_height,
                        image_width, radius_of_pixel, radius_of_block,
                    )  # fmt: skip
    return out
