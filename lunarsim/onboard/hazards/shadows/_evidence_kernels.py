# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled evidence for clear terrain: whether a shadow would fall on lit terrain."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.models._pinhole_kernels import to_pixel
from lunarsim.onboard.hazards.shadows._lit_tile_kernels import (
    CORE,
    FAR,
    MOST_STEPS,
    ROUNDING,
    SHARP,
    E,
    H,
    N,
    X,
    Y,
    Z,
    all_lit,
    extents,
    largest_of_blocks,
    lit_tiles,
    lit_within,
    spread,
    tile_at,
)

# Columns of a coarse node before those of the core points.
SHARPNESS, EAST, NORTH, HEIGHT, REACH, POINTS = 0, 1, 2, 3, 4, 5
# Up to this number of steps, heights are tested one by one.
_FEW_STEPS = 4


@kernel()
def _along_sensor(coarse, position, axes):
    """Transform the nodes of a coarse grid to sensor axes (rows, cols, columns).

    `coarse` are the nodes as described for `look`. `position` (3,) is the camera, m, and `axes` (3,
    3) its axes.
    """
    rows, cols, width = coarse.shape
    points = (width - POINTS) // 2
    out = np.empty((rows, cols, CORE + 3 * points))
    off = np.empty(3)
    for i in range(rows):
        for j in range(cols):
            out[i, j, SHARP] = coarse[i, j, SHARPNESS]
            out[i, j, FAR] = coarse[i, j, REACH]
            for c in range(3):
                off[c] = coarse[i, j, EAST + c] - position[c]
                out[i, j, E + c] = off[c]
            for c in range(3):
                out[i, j, X + c] = axes[0, c] * off[0] + axes[1, c] * off[1] + axes[2, c] * off[2]
                for k in range(points):
                    e, n = coarse[i, j, POINTS + 2 * k], coarse[i, j, POINTS + 2 * k + 1]
                    out[i, j, CORE + c * points + k] = axes[0, c] * e + axes[1, c] * n
    return out


@kernel()
def _row_of_nodes(nodes, i, every):
    """Interpolate the nodes of a coarse grid to row `i` of the positions.

    There are `every` positions between two nodes. The result has shape (node cols, columns).
    """
    first = min(i // every, nodes.shape[0] - 2)
    share = i / every - first
    out = np.empty(nodes.shape[1:])
    for j in range(out.shape[0]):
        for k in range(out.shape[1]):
            step = nodes[first + 1, j, k] - nodes[first, j, k]
            out[j, k] = nodes[first, j, k] + share * step
    return out


@kernel(allocates=False)
def _between(out, nodes, first, share):
    """Interpolate between nodes `first` and `first + 1` of a row, at fraction `share`.

    `out` (columns,) receives the result.
    """
    for k in range(len(out)):
        out[k] = nodes[first, k] + share * (nodes[first + 1, k] - nodes[first, k])


@kernel(exact=True)
def _pixels_of_core(at, here, by, up, radius, lens, high, wide):
    """Compute the pixels of a shadow's test points; return whether all are in view.

    The test points lie in the core of the shadow, the part that is dark for every rock shape. `at`
    (points,) receives the pixel indices, row by row. `here` is the interpolated node of the rock's
    position, `by` a rise of the terrain, m, `up` (3,) the vertical in sensor axes, and `radius` the
    radius of the rock, m. `lens` is (fx, fy, cx, cy); `high` and `wide` are the size of the image,
    pixels. The loop has no branch before the end, so that it can be vectorised.
    """
    fx, fy, cx, cy = lens
    points = len(at)
    x0, y0, z0 = here[X] + by * up[0], here[Y] + by * up[1], here[Z] + by * up[2]
    out = 0
    for k in range(points):
        x = x0 + radius * here[CORE + k]
        y = y0 + radius * here[CORE + points + k]
        z = z0 + radius * here[CORE + 2 * points + k]
        px, py = to_pixel(x, y, z, fx, fy, cx, cy)
        inside = (z > 0.0) & (px >= 0.0) & (py >= 0.0) & (px <= wide - 1) & (py <= high - 1)
        out += not inside
        at[k] = np.int32(py + 0.5) * wide + np.int32(px + 0.5) if inside else np.int32(0)
    return out == 0


@kernel(allocates=False)
def _dark_points(at, here, by, up, cores, radius, lens, high, wide, shadow_of):
    """Count the dark test points of a rock's expected shadow.

    Returns the number for the darkest of the `cores` possible shadows, and how many of these points
    belong to shadows of tracked rocks; -1 if a point is out of view. A point is dark if it may be
    in the shadow of a rock of this `radius`, m, according to `shadow_of` (the largest radius for
    each pixel, negative for tracked rocks). The terrain at the position `here` is raised by `by`,
    m; `up` is the vertical in sensor axes. `lens`, `high` and `wide` are the projection and size of
    the image.
    """
    if not _pixels_of_core(at, here, by, up, radius, lens, high, wide):
        return -1, 0
    each = len(at) // cores
    most = of_most = 0
    for first in range(0, cores * each, each):
        dark = explained = 0
        for k in range(first, first + each):
            of = shadow_of[at[k]]
            dark += abs(of) >= radius
            explained += -of >= radius
        # Of two equally dark cores, the less explained one counts.
        if dark > most or (dark == most and explained < of_most):
            most, of_most = dark, explained
    return most, of_most


@kernel(allocates=False)
def _dark_elsewhere(at, here, extent, up, cores, radius, lens, high, wide, shadow_of, blocks):
    """Return whether a shadow may fall on dark terrain at another terrain height.

    The height varies by the possible error at the position `here`, which displaces the terrain
    laterally in the image, in steps of about the radius of the rock. The shadow of a tracked rock
    does not count as dark. The other arguments are those of `_dark_points` and `lit_within`.
    """
    reach, e, n, h = here[FAR], here[E], here[N], here[H]
    lateral = reach * np.sqrt(e * e + n * n) / max(-h, 1e-9)
    # NaN also returns True.
    if not lateral < (MOST_STEPS + 0.5) * radius:
        return True
    steps = int(lateral / radius + 0.5)
    # Test many heights at once as long as they show nothing dark, otherwise half as many.
    step, many = -steps, steps if steps > _FEW_STEPS else 1
    while step <= steps:
        last = min(step + many - 1, steps)
        by = reach * step / max(steps, 1)
        if many > 1:
            if lit_within(
                here, here, extent, by, reach * last / steps, up, radius, lens, high, wide,
                shadow_of, blocks,
            ):  # fmt: skip
                step, many = last + 1, 2 * many
            else:
                many //= 2
            continue
        if step != 0:
            count, tracked = _dark_points(
                at, here, by, up, cores, radius, lens, high, wide, shadow_of
            )
            if count < 0 or count > tracked:
                return True
        step, many = step + 1, 2 if steps > _FEW_STEPS else 1
    return False


@kernel()
def _middle_may_show(coarse, i, j, radius, position, axes, fx, fy, cx, cy, wide, high):
    """Return whether the centre of a shadow may be in view within a square of nodes.

    `i` and `j` locate the square in the grid of nodes `coarse`, and `radius` is that of the rock,
    m. The other arguments are the camera parameters of `View`.
    """
    behind = left = right = above = below = 0
    for a in range(i, i + 2):
        for b in range(j, j + 2):
            e = coarse[a, b, EAST] + radius * coarse[a, b, POINTS] - position[0]
            n = coarse[a, b, NORTH] + radius * coarse[a, b, POINTS + 1] - position[1]
            h = coarse[a, b, HEIGHT] - position[2]
            z = axes[0, 2] * e + axes[1, 2] * n + axes[2, 2] * h
            if not z > 0.0:
                behind += z <= 0.0
                continue
            x = axes[0, 0] * e + axes[1, 0] * n + axes[2, 0] * h
            y = axes[0, 1] * e + axes[1, 1] * n + axes[2, 1] * h
            px, py = to_pixel(x, y, z, fx, fy, cx, cy)
            left += px < -ROUNDING
            right += px > wide - 1 + ROUNDING
            above += py < -ROUNDING
            below += py > high - 1 + ROUNDING
    return max(behind, left, right, above, below) < 4


@kernel(parallel=True)
def _squares_in_view(coarse, radii, position, axes, fx, fy, cx, cy, wide, high):
    """Return in which squares of nodes a shadow may be in view (rows, cols, sizes).

    `coarse` are the nodes and `radii` (sizes,), m, the radii of the rocks. The other arguments are
    the camera parameters of `View`.
    """
    rows, cols = coarse.shape[0] - 1, coarse.shape[1] - 1
    out = np.empty((rows, cols, len(radii)), np.bool_)
    for i in prange(rows):
        for j in range(cols):
            for s in range(len(radii)):
                out[i, j, s] = _middle_may_show(
                    coarse, i, j, radii[s], position, axes, fx, fy, cx, cy, wide, high
                )
    return out


@kernel(parallel=True)
def _shadow_of(labels, largest):
    """Return the largest possible rock radius for each pixel, row by row, m.

    `labels` (height, width) is the dark patch of each pixel, and `largest` the radius for each
    patch.
    """
    high, wide = labels.shape
    out = np.empty(high * wide, largest.dtype)
    for row in prange(high):
        for col in range(wide):
            out[row * wide + col] = largest[labels[row, col]]
    return out


@kernel()
def _look_along(
    i, lit, dark, explained, radii, nodes, in_view, clear, every, up, lens, shape, shadow_of,
    blocks, min_count, gain, cores,
):  # fmt: skip
    """Record whether shadows of rocks in grid row `i` would fall on dark pixels.

    For each rock size, `lit` and `dark` (sizes, rows, cols) receive whether the predicted shadow
    falls on lit or on dark pixels. The other arguments are those of `look`, which calls this.
    """
    sizes, _, cols = lit.shape
    high, wide = np.int32(shape[0]), np.int32(shape[1])
    row = _row_of_nodes(nodes, i, every)
    here = np.empty(nodes.shape[2])
    at = np.empty((len(here) - CORE) // 3, np.int32)
    vi = min(i // every, nodes.shape[0] - 2)
    tile_row = tile_at(i, vi, every)
    for j in range(cols):
        uj = min(j // every, len(row) - 2)
        u = j / every - uj
        sharpness = row[uj, SHARP] + u * (row[uj + 1, SHARP] - row[uj, SHARP])
        if not sharpness > 0.0:
            continue
        tile_col = tile_at(j, uj, every)
        # Computed when the first size needs it.
        known, extent = False, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for s in range(sizes):
            if not in_view[vi, uj, s]:
                continue
            if sharpness <= gain * max(lit[s, i, j], dark[s, i, j]):
                continue
            if clear[tile_row, tile_col, s]:
                lit[s, i, j] = sharpness
                continue
            if not known:
                _between(here, row, uj, u)
                extent = extents(here, here)
                known = True
            if all_lit(here, here, extent, up, radii[s], lens, high, wide, shadow_of, blocks):
                lit[s, i, j] = sharpness
                continue
            count, tracked = _dark_points(
                at, here, 0.0, up, cores, radii[s], lens, high, wide, shadow_of
            )
            if count >= min_count:
                dark[s, i, j] = sharpness
                explained[s, i, j] = 2 * tracked > count
            elif count >= 0 and not _dark_elsewhere(
                at, here, extent, up, cores, radii[s], lens, high, wide, shadow_of, blocks
            ):
                lit[s, i, j] = sharpness


@kernel(parallel=True)
def look(
    lit, dark, explained, radii, coarse, every, position, axes, fx, fy, cx, cy, labels, largest,
    min_count, gain, cores,
):  # fmt: skip
    """Record at which positions the shadow of a rock would fall on lit terrain.

    This excludes an undetected rock of that size there. The shadow counts as falling on lit terrain
    only if it does so at all possible terrain heights. Terrain that is dark only at another height
    is recorded neither as lit nor as dark.

    Parameters
    ----------
    lit, dark
        Sharpness of the sharpest observation in which the shadow falls on lit and on dark terrain
        (sizes, rows, cols); updated. Sharpness is the square root of the number of dark pixels of a
        rock of radius 1 m.
    explained
        Whether the dark terrain was the shadow of a tracked rock (sizes, rows, cols); updated.
    radii
        Radii of the rocks (sizes,), m.
    coarse
        Nodes at every `every`-th position, linear in between. Each contains the sharpness of this
        observation, east and north, terrain height and its possible error, m, and east and north of
        the test points of the possible shadows of a rock with a half axis of 1, shadow by shadow.
    position, axes, fx, fy, cx, cy
        Camera parameters of `View`: position (3,), m, axes (3, 3), focal lengths and principal
        point, pixels.
    labels
        Dark patch of each pixel (height, width), 0 where the image is lit.
    largest
        Radius of the largest rock that may cast each patch, m; negative for tracked rocks.
    min_count
        Minimum number of dark points for a rock to be possible.
    gain
        Minimum ratio of the sharpness to that of earlier observations for an update.
    cores
        Number of possible shadows of a rock of one size (of different shape), with equally many
        test points.
    """
    high, wide = labels.shape
    in_view = _squares_in_view(coarse, radii, position, axes, fx, fy, cx, cy, wide, high)
    shadow_of = _shadow_of(labels, largest)
    nodes = _along_sensor(coarse, position, axes)
    lens = (fx, fy, cx, cy)
    blocks = largest_of_blocks(shadow_of, high, wide)
    clear = lit_tiles(nodes, every, radii, axes[2], lens, high, wide, shadow_of, blocks)
    order = spread(lit.shape[1])
    for k in prange(lit.shape[1]):
        _look_along(
            order[k], lit, dark, explained, radii, nodes, in_view, clear, every, axes[2], lens,
            labels.shape, shadow_of, blocks, min_count, gain, cores,
        )  # fmt: skip
