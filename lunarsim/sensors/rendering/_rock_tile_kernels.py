# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled selection of tiles of rocks for an image or a shadow map.

Omitted tiles are certainly empty: bounds cover complete tiles and include a rounding margin.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

# Relative margin of bounds, with a minimum of this many metres or texels.
_RELATIVE_MARGIN = 1e-6


@kernel()
def tile_bounds(rocks, reach, foot, order, start):
    """Return the bounds of the rocks in each tile: low, high, radius, margin.

    Tile t contains the rocks `order[start[t]:start[t + 1]]`. `low` and `high` (t, 3) bound the
    rocks' positions and their elevations from foot to top. `radius` (t,) is that of the largest
    sphere around a rock's base that contains the rock, as in `visible_rocks`. `margin` (t,) is the
    maximum lateral extent of a rock's box.
    """
    count = start.size - 1
    low = np.full((count, 3), np.inf)
    high = np.full((count, 3), -np.inf)
    radius = np.zeros(count)
    margin = np.zeros(count)
    for t in range(count):
        for m in range(start[t], start[t + 1]):
            n = order[m]
            for k in range(3):
                low[t, k] = min(low[t, k], rocks[n, k])
                high[t, k] = max(high[t, k], rocks[n, k])
            low[t, 2] = min(low[t, 2], foot[n])
            high[t, 2] = max(high[t, 2], rocks[n, 2] + rocks[n, 5])
            radius[t] = max(radius[t], 1.5 * reach[n] + max(rocks[n, 5], rocks[n, 2] - foot[n]))
            margin[t] = max(margin[t], 1.5 * reach[n])
    return low, high, radius, margin


@kernel()
def tiles_in_view(low, high, radius, viewpoint, to_sensor, fx, fy, cx, cy, width, height, near):
    """Return which tiles (t,) may contain a rock that is visible in an image.

    `low`, `high` (t, 3) and `radius` (t,) are bounds of the tiles, as from `tile_bounds`.
    `viewpoint` (3,) is the camera, `to_sensor` (3, 3) the rotation from ENU, `fx` to `cy` are the
    focal lengths and principal point, `width` x `height` is the image size, pixels, and `near` the
    minimum depth, m.
    """
    count = low.shape[0]
    kept = np.zeros(count, np.bool_)
    # Inward normals of the view's sides in sensor axes.
    sides = np.array([
        [0.0, 0.0, 1.0],
        [fx, 0.0, cx + 0.5],
        [-fx, 0.0, width - 0.5 - cx],
        [0.0, fy, cy + 0.5],
        [0.0, -fy, height - 0.5 - cy],
    ])  # fmt: skip
    normal = np.empty((5, 3))
    size = np.empty(5)
    for s in range(5):
        size[s] = np.sqrt(sides[s, 0] ** 2 + sides[s, 1] ** 2 + sides[s, 2] ** 2)
        for k in range(3):
            normal[s, k] = 0.0
            for i in range(3):
                normal[s, k] += sides[s, i] * to_sensor[i, k]
    for t in range(count):
        kept[t] = True
        for s in range(5):
            maximum = 0.0
            scale = 0.0
            for k in range(3):
                lower = (low[t, k] - viewpoint[k]) * normal[s, k]
                upper = (high[t, k] - viewpoint[k]) * normal[s, k]
                maximum += max(lower, upper)
                scale += max(abs(lower), abs(upper))
            begin = near if s == 0 else 0.0
            spare = _RELATIVE_MARGIN * (scale + size[s] * (1.0 + radius[t]))
            if maximum < begin - radius[t] * size[s] - spare:
                kept[t] = False
                break
    return kept


@kernel()
def tiles_that_shade(low, high, margin, viewpoint, lean, axes, corner, texel, width, height):
    """Return which tiles (t,) may contain a rock that casts shadows onto a shadow map.

    `low`, `high` (t, 3) and `margin` (t,) are bounds of the tiles, as from `tile_bounds`;
    `viewpoint` (3,) is the camera. The map is given by `lean`, `axes`, `corner` and `texel` of
    `ShadowFrame`, and has `width` x `height` texels.
    """
    count = low.shape[0]
    kept = np.zeros(count, np.bool_)
    for t in range(count):
        kept[t] = True
        for s in range(2):
            # The map position is linear in the point.
            rise = -(axes[s, 0] * lean[0] + axes[s, 1] * lean[1])
            minimum = -corner[s]
            maximum = -corner[s]
            scale = abs(corner[s]) + margin[t]
            for k in range(3):
                slope = rise if k == 2 else axes[s, k]
                wider = 0.0 if k == 2 else margin[t]
                lower = (low[t, k] - wider - viewpoint[k]) * slope
                upper = (high[t, k] + wider - viewpoint[k]) * slope
                minimum += min(lower, upper)
                maximum += max(lower, upper)
                scale += max(abs(lower), abs(upper))
            spare = texel + _RELATIVE_MARGIN * scale
            last = (width if s == 0 else height) * texel
            if maximum < -spare or minimum > last + spare:
                kept[t] = False
                break
    return kept


@kernel()
def rocks_in_tiles(order, start, kept):
    """Return the indices of the rocks in the selected tiles, in ascending order.

    Tile t contains the rocks `order[start[t]:start[t + 1]]`; `kept` (t,) is the selection.
    """
    mark = np.zeros(order.size, np.bool_)
    for t in range(kept.size):
        if kept[t]:
            for m in range(start[t], start[t + 1]):
                mark[order[m]] = True
    return np.flatnonzero(mark).astype(np.int32)
