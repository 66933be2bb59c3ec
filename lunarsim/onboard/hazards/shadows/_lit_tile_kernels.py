"""Compiled search for ground about which a picture is lit far and wide, tile by tile.

Where nothing dark lies in the box of a picture that holds all points of all shadows of a tile's
places, their shadows would fall on lit ground, whichever place is asked. The box is that of
interval arithmetic: between the nodes all that is told of places is linear east and north, so it
lies between the least and greatest of a tile's corners.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange

# Columns of a node as the camera has it: sharpness, reach, the place off the camera, east, north,
# up, the same along the sensor's axes, and along these the core's points, x of all, then y, then z.
SHARP, FAR, E, N, H, X, Y, Z, CORE = range(9)
# Ground that may show farther aside than so many radii of a rock is not searched for it.
MOST_STEPS = 16
# Sides of a tile, places, and of a block of pixels, whose largest rock is worked out once.
_TILE, _BLOCK = 8, 4
# What rounding may move a point of the picture by, pixels.
ROUNDING = 0.01


@kernel(parallel=True)
def largest_of_blocks(shadow_of, high, wide):
    """Return the largest rock that a shadow in each block of pixels may be of (rows, cols), m.

    `shadow_of` is the radius told of each pixel, row after row, see `look`.
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
    """Return into how many tiles the side of a square of nodes is cut, `every` places long."""
    return max(1, every // _TILE)


@kernel(exact=True)
def tile_at(place, node, every):
    """Return the tile, along one side of all squares, of a place behind a node."""
    tiles = tiles_of(every)
    return node * tiles + min((place - node * every) * tiles // every, tiles - 1)


@kernel(allocates=False)
def _corners(low, high, nodes, i, j, every, tile_row, tile_col):
    """Write the least and greatest of all columns in a tile of the square at node (i, j)."""
    tiles = tiles_of(every)
    low[:], high[:] = np.inf, -np.inf
    for a in range(2):
        # A tile begins with the first place that belongs to it.
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
def _axis(low, high, first, points, at, by, up, radius):
    """Return between which coordinates all points of a tile's cores lie, along one axis."""
    least, most = np.inf, -np.inf
    for k in range(first, first + points):
        least, most = min(least, low[k]), max(most, high[k])
    aside = by * abs(up)
    return low[at] - aside + radius * least, high[at] + aside + radius * most


@kernel(exact=True)
def _pixels(low, high, near, far, focal, centre):
    """Return between which pixels what lies between two coordinates and depths is seen."""
    least = focal * (low / near if low < 0.0 else low / far) + centre - ROUNDING
    most = focal * (high / near if high > 0.0 else high / far) + centre + ROUNDING
    return least, most


@kernel(allocates=False, inner=True)
def all_lit(low, high, up, radius, lens, height, width, blocks):
    """Tell whether nothing dark enough lies where shadows of a tile's places may fall.

    And all of that is in view, and searched, see `_dark_elsewhere`.
    """
    fx, fy, cx, cy = lens
    points = (len(low) - CORE) // 3
    by = max(abs(low[FAR]), abs(high[FAR]))
    east, north = max(abs(low[E]), abs(high[E])), max(abs(low[N]), abs(high[N]))
    aside = by * np.sqrt(east * east + north * north) / max(-high[H], 1e-9)
    if not aside < MOST_STEPS * radius:
        return False
    near, far = _axis(low, high, CORE + 2 * points, points, Z, by, up[2], radius)
    if not near > 0.0:
        return False
    x0, x1 = _axis(low, high, CORE, points, X, by, up[0], radius)
    y0, y1 = _axis(low, high, CORE + points, points, Y, by, up[1], radius)
    left, right = _pixels(x0, x1, near, far, fx, cx)
    upper, lower = _pixels(y0, y1, near, far, fy, cy)
    if not (left >= 0.0 and upper >= 0.0 and right <= width - 1 and lower <= height - 1):
        return False
    for row in range(int(upper + 0.5) // _BLOCK, int(lower + 0.5) // _BLOCK + 1):
        for col in range(int(left + 0.5) // _BLOCK, int(right + 0.5) // _BLOCK + 1):
            if blocks[row, col] >= radius:
                return False
    return True


@kernel(parallel=True)
def lit_tiles(nodes, every, radii, up, lens, height, width, blocks):
    """Tell of which tiles and sizes of rocks all shadows would fall on lit ground.

    Parameters
    ----------
    nodes
        As the camera has them (rows, cols, columns).
    every
        Places from node to node.
    radii
        Of the rocks (sizes,), m.
    up
        The vertical along the sensor's axes (3,).
    lens, height, width
        fx, fy, cx, cy, and the size of the picture, pixels.
    blocks
        See `largest_of_blocks`.

    Returns
    -------
    lit
        (tile rows, tile cols, sizes); see `tile_at`.
    """
    tiles = tiles_of(every)
    rows, cols = (nodes.shape[0] - 1) * tiles, (nodes.shape[1] - 1) * tiles
    out = np.zeros((rows, cols, len(radii)), np.bool_)
    for row in prange(rows):
        low, high = np.empty(nodes.shape[2]), np.empty(nodes.shape[2])
        for col in range(cols):
            i, j = row // tiles, col // tiles
            if _corners(low, high, nodes, i, j, every, row - i * tiles, col - j * tiles):
                for s in range(len(radii)):
                    out[row, col, s] = all_lit(low, high, up, radii[s], lens, height, width, blocks)
    return out
