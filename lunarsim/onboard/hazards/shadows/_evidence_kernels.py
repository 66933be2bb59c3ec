# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled evidence for clear terrain: whether a shadow would fall on lit terrain."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.models._pinhole_kernels import to_pixel
from lunarsim.onboard.hazards.shadows._lit_tile_kernels import (
    CORE,
    FAR,
    MAX_STEPS,
    ROUNDING,
    SHARP,
    E,
    H,
    N,
    X,
    Y,
    Z,
    balanced_row_order,
    is_lit_between,
    is_tile_lit,
    lit_tiles,
    max_radius_of_blocks,
    shadow_extents,
    tile_index,
)

# Columns of a coarse node before those of the core points.
SHARPNESS, EAST, NORTH, HEIGHT, REACH, POINTS = 0, 1, 2, 3, 4, 5
# Up to this number of steps, heights are tested one by one.
_FEW_STEPS = 4


@kernel()
def _nodes_in_sensor_axes(coarse_nodes, position, axes):
    """Transform the nodes of a coarse grid to sensor axes (rows, cols, columns).

    `coarse_nodes` are described in `record_observation`; the columns of the result are named in
    `_lit_tile_kernels`. `position` (3,), m, and `axes` (3, 3) are those of the camera.
    """
    rows, cols, width = coarse_nodes.shape
    points = (width - POINTS) // 2
    out = np.empty((rows, cols, CORE + 3 * points))
    off = np.empty(3)
    for i in range(rows):
        for j in range(cols):
            out[i, j, SHARP] = coarse_nodes[i, j, SHARPNESS]
            out[i, j, FAR] = coarse_nodes[i, j, REACH]
            for c in range(3):
                off[c] = coarse_nodes[i, j, EAST + c] - position[c]
                out[i, j, E + c] = off[c]
            for c in range(3):
                out[i, j, X + c] = axes[0, c] * off[0] + axes[1, c] * off[1] + axes[2, c] * off[2]
                for k in range(points):
                    e, n = (
                        coarse_nodes[i, j, POINTS + 2 * k],
                        coarse_nodes[i, j, POINTS + 2 * k + 1],
                    )
                    out[i, j, CORE + c * points + k] = axes[0, c] * e + axes[1, c] * n
    return out


@kernel()
def _interpolate_row(nodes, i, node_spacing):
    """Interpolate the nodes of a coarse grid to row `i` of the fine grid.

    `nodes` (node rows, node cols, columns) are `node_spacing` fine rows apart. The result has shape
    (node cols, columns).
    """
    first = min(i // node_spacing, nodes.shape[0] - 2)
    fraction = i / node_spacing - first
    out = np.empty(nodes.shape[1:])
    for j in range(out.shape[0]):
        for k in range(out.shape[1]):
            step = nodes[first + 1, j, k] - nodes[first, j, k]
            out[j, k] = nodes[first, j, k] + fraction * step
    return out


@kernel(allocates=False)
def _interpolate_node(out, nodes, first, fraction):
    """Interpolate between the nodes `first` and `first + 1` of a row.

    `fraction` is the position between them, from 0 to 1. `out` (columns,) receives the result.
    """
    for k in range(len(out)):
        out[k] = nodes[first, k] + fraction * (nodes[first + 1, k] - nodes[first, k])


@kernel(exact=True)
def _pixels_of_test_points(pixels, node, rise, up, radius, intrinsics, image_height, image_width):
    """Project the test points of a rock's shadow; return whether all are in view.

    The test points lie in the core of the shadow, the part that is dark for every rock shape.
    `pixels` (points,) receives their flat pixel indices, row * image width + column; 0 for a point
    out of view. `node` (columns,) is the node interpolated at the rock, `rise` an assumed error of
    its terrain height, m, `up` (3,) the vertical in sensor axes, and `radius` the radius of the
    rock, m. `intrinsics` is (fx, fy, cx, cy). The loop does not end early, so that it can be
    vectorised.
    """
    fx, fy, cx, cy = intrinsics
    points = len(pixels)
    x0, y0, z0 = node[X] + rise * up[0], node[Y] + rise * up[1], node[Z] + rise * up[2]
    out = 0
    for k in range(points):
        x = x0 + radius * node[CORE + k]
        y = y0 + radius * node[CORE + points + k]
        z = z0 + radius * node[CORE + 2 * points + k]
        px, py = to_pixel(x, y, z, fx, fy, cx, cy)
        inside = (
            (z > 0.0)
            & (px >= 0.0)
            & (py >= 0.0)
            & (px <= image_width - 1)
            & (py <= image_height - 1)
        )
        out += not inside
        pixels[k] = np.int32(py + 0.5) * image_width + np.int32(px + 0.5) if inside else np.int32(0)
    return out == 0


@kernel(allocates=False)
def _dark_points(
    pixels, node, rise, up, shape_count, radius, intrinsics, image_height, image_width,
    radius_of_pixel,
):  # fmt: skip
    """Count the dark test points of the shadow that a rock would cast.

    Returns the number for the darkest of the `shape_count` possible shadows, and how many of these
    points belong to shadows of tracked rocks; (-1, 0) if a point is out of view. A point is dark if
    the largest rock that may shade its pixel, `radius_of_pixel` (m, negative for tracked rocks), is
    not smaller than the rock. `pixels` is a work array. `node` describes the viewing geometry at
    the rock, `rise` is an assumed error of its terrain height, m, and `radius` its radius, m. The
    other arguments describe the camera, as in `_pixels_of_test_points`.
    """
    if not _pixels_of_test_points(
        pixels, node, rise, up, radius, intrinsics, image_height, image_width
    ):
        return -1, 0
    each = len(pixels) // shape_count
    most = of_most = 0
    for first in range(0, shape_count * each, each):
        dark = explained = 0
        for k in range(first, first + each):
            of = radius_of_pixel[pixels[k]]
            dark += abs(of) >= radius
            explained += -of >= radius
        # Of two equally dark cores, the less explained one counts.
        if dark > most or (dark == most and explained < of_most):
            most, of_most = dark, explained
    return most, of_most


@kernel(allocates=False)
def _may_be_dark_at_other_heights(
    pixels, node, shadow_extent, up, shape_count, radius, intrinsics, image_height, image_width,
    radius_of_pixel, radius_of_block,
):  # fmt: skip
    """Return whether a shadow may fall on dark pixels if the terrain height is wrong.

    A height error displaces the shadow laterally in the image. Heights within the possible error at
    `node` are tested in steps that displace it by about the radius of the rock. The shadow of a
    tracked rock does not count as dark. The result is also True if the shadow may be out of view or
    be displaced by more than MAX_STEPS radii. The other arguments are those of `_dark_points` and
    `is_lit_between`.
    """
    reach, e, n, h = node[FAR], node[E], node[N], node[H]
    lateral = reach * np.sqrt(e * e + n * n) / max(-h, 1e-9)
    # NaN also returns True.
    if not lateral < (MAX_STEPS + 0.5) * radius:
        return True
    steps = int(lateral / radius + 0.5)
    # Test many heights at once as long as they show nothing dark, otherwise half as many.
    step, many = -steps, steps if steps > _FEW_STEPS else 1
    while step <= steps:
        last = min(step + many - 1, steps)
        rise = reach * step / max(steps, 1)
        if many > 1:
            if is_lit_between(
                node, node, shadow_extent, rise, reach * last / steps, up, radius, intrinsics,
                image_height, image_width, radius_of_pixel, radius_of_block,
            ):  # fmt: skip
                step, many = last + 1, 2 * many
            else:
                many //= 2
            continue
        if step != 0:
            count, tracked = _dark_points(
                pixels, node, rise, up, shape_count, radius, intrinsics, image_height, image_width,
                radius_of_pixel,
            )  # fmt: skip
            if count < 0 or count > tracked:
                return True
        step, many = step + 1, 2 if steps > _FEW_STEPS else 1
    return False


@kernel()
def _may_be_in_view(
    coarse_nodes, i, j, radius, position, axes, fx, fy, cx, cy, image_width, image_height
):
    """Return whether the centre of a shadow may be in view within a square of nodes.

    (`i`, `j`) is the south-west node of the square in `coarse_nodes` (rows, cols, columns), and
    `radius` that of the rock, m. The other arguments are position (3,), m, axes (3, 3), focal
    lengths, principal point and image size of the camera.
    """
    behind = left = right = above = below = 0
    for a in range(i, i + 2):
        for b in range(j, j + 2):
            e = coarse_nodes[a, b, EAST] + radius * coarse_nodes[a, b, POINTS] - position[0]
            n = coarse_nodes[a, b, NORTH] + radius * coarse_nodes[a, b, POINTS + 1] - position[1]
            h = coarse_nodes[a, b, HEIGHT] - position[2]
            z = axes[0, 2] * e + axes[1, 2] * n + axes[2, 2] * h
            if not z > 0.0:
                behind += z <= 0.0
                continue
            x = axes[0, 0] * e + axes[1, 0] * n + axes[2, 0] * h
            y = axes[0, 1] * e + axes[1, 1] * n + axes[2, 1] * h
            px, py = to_pixel(x, y, z, fx, fy, cx, cy)
            left += px < -ROUNDING
            right += px > image_width - 1 + ROUNDING
            above += py < -ROUNDING
            below += py > image_height - 1 + ROUNDING
    return max(behind, left, right, above, below) < 4


@kernel(parallel=True)
def _squares_in_view(
    coarse_nodes, radii, position, axes, fx, fy, cx, cy, image_width, image_height
):
    """Return in which squares of nodes a shadow may be in view (rows, cols, sizes).

    A square has four neighbouring nodes of `coarse_nodes` as corners. `radii` (sizes,), m, are
    those of the rocks; the other arguments describe the camera, as in `record_observation`.
    """
    rows, cols = coarse_nodes.shape[0] - 1, coarse_nodes.shape[1] - 1
    out = np.empty((rows, cols, len(radii)), np.bool_)
    for i in prange(rows):
        for j in range(cols):
            for s in range(len(radii)):
                out[i, j, s] = _may_be_in_view(
                    coarse_nodes, i, j, radii[s], position, axes, fx, fy, cx, cy, image_width,
                    image_height,
                )  # fmt: skip
    return out


@kernel(parallel=True)
def _radius_of_pixels(labels, radius_of_patch):
    """Return the radius of the largest rock that may shade each pixel, row by row, m.

    The result has shape (height * width,). `labels` (height, width) is the dark patch of each
    pixel, and `radius_of_patch` (labels + 1,) the radius for each patch, m.
    """
    image_height, image_width = labels.shape
    out = np.empty(image_height * image_width, radius_of_patch.dtype)
    for row in prange(image_height):
        for col in range(image_width):
            out[row * image_width + col] = radius_of_patch[labels[row, col]]
    return out


@kernel()
def _record_row(
    i, lit, dark, explained, radii, nodes, in_view, lit_tile_sizes, node_spacing, up, intrinsics,
    shape, radius_of_pixel, radius_of_block, min_count, min_gain, shape_count,
):  # fmt: skip
    """Record whether shadows of rocks in row `i` of the grid would fall on lit pixels.

    `lit`, `dark` and `explained` are updated in this row. `nodes` are the nodes of the coarse grid
    in sensor axes, `up` (3,) is the vertical in sensor axes, `intrinsics` (fx, fy, cx, cy) and
    `shape` (height, width of the image). `radius_of_pixel`, `radius_of_block`, `in_view` and
    `lit_tile_sizes` are the results of `_radius_of_pixels`, `max_radius_of_blocks`,
    `_squares_in_view` and `lit_tiles`. The other arguments are those of `record_observation`, which
    calls this.
    """
    sizes, _, cols = lit.shape
    image_height, image_width = np.int32(shape[0]), np.int32(shape[1])
    row = _interpolate_row(nodes, i, node_spacing)
    node = np.empty(nodes.shape[2])
    pixels = np.empty((len(node) - CORE) // 3, np.int32)
    vi = min(i // node_spacing, nodes.shape[0] - 2)
    tile_row = tile_index(i, vi, node_spacing)
    for j in range(cols):
        uj = min(j // node_spacing, len(row) - 2)
        u = j / node_spacing - uj
        sharpness = row[uj, SHARP] + u * (row[uj + 1, SHARP] - row[uj, SHARP])
        if not sharpness > 0.0:
            continue
        tile_col = tile_index(j, uj, node_spacing)
        # Computed when the first size needs it.
        known, shadow_extent = False, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for s in range(sizes):
            if not in_view[vi, uj, s]:
                continue
            if sharpness <= min_gain * max(lit[s, i, j], dark[s, i, j]):
                continue
            if lit_tile_sizes[tile_row, tile_col, s]:
                lit[s, i, j] = sharpness
                continue
            if not known:
                _interpolate_node(node, row, uj, u)
                shadow_extent = shadow_extents(node, node)
                known = True
            if is_tile_lit(
                node, node, shadow_extent, up, radii[s], intrinsics, image_height, image_width,
                radius_of_pixel, radius_of_block,
            ):  # fmt: skip
                lit[s, i, j] = sharpness
                continue
            count, tracked = _dark_points(
                pixels, node, 0.0, up, shape_count, radii[s], intrinsics, image_height, image_width,
                radius_of_pixel,
            )  # fmt: skip
            if count >= min_count:
                dark[s, i, j] = sharpness
                explained[s, i, j] = 2 * tracked > count
            elif count >= 0 and not _may_be_dark_at_other_heights(
                pixels, node, shadow_extent, up, shape_count, radii[s], intrinsics, image_height,
                image_width, radius_of_pixel, radius_of_block,
            ):  # fmt: skip
                lit[s, i, j] = sharpness


@kernel(parallel=True)
def record_observation(
    lit, dark, explained, radii, coarse_nodes, node_spacing, position, axes, fx, fy, cx, cy, labels,
    radius_of_patch, min_count, min_gain, shape_count,
):  # fmt: skip
    """Record at which positions the shadow of a rock would fall on lit terrain.

    If it does, there is no undetected rock of that size. The shadow must fall on lit terrain at all
    possible terrain heights. If it falls on dark terrain only at a height other than the estimate,
    it is recorded neither as lit nor as dark. Nothing is recorded for shadows out of view.

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
    coarse_nodes
        Values at every `node_spacing`-th position, linear in between: the sharpness of this
        observation, east and north, terrain height and its possible error, m, and east and north of
        the test points of the possible shadows of a rock with a half axis of 1, shadow by shadow.
    position, axes, fx, fy, cx, cy
        Camera parameters of `View`: position (3,), m, axes (3, 3), focal lengths and principal
        point, pixels.
    labels
        Dark patch of each pixel (height, width), 0 where the image is lit.
    radius_of_patch
        Radius of the largest rock that may cast each patch, m; negative for tracked rocks.
    min_count
        Minimum number of dark test points for a rock to be possible.
    min_gain
        Minimum ratio of the sharpness to that of earlier observations for an update.
    shape_count
        Number of possible shadows of a rock of one size (of different shape), with equally many
        test points.
    """
    image_height, image_width = labels.shape
    in_view = _squares_in_view(
        coarse_nodes, radii, position, axes, fx, fy, cx, cy, image_width, image_height
    )
    radius_of_pixel = _radius_of_pixels(labels, radius_of_patch)
    nodes = _nodes_in_sensor_axes(coarse_nodes, position, axes)
    intrinsics = (fx, fy, cx, cy)
    radius_of_block = max_radius_of_blocks(radius_of_pixel, image_height, image_width)
    lit_tile_sizes = lit_tiles(
        nodes, node_spacing, radii, axes[2], intrinsics, image_height, image_width, radius_of_pixel,
        radius_of_block,
    )  # fmt: skip
    order = balanced_row_order(lit.shape[1])
    for k in prange(lit.shape[1]):
        _record_row(
            order[k], lit, dark, explained, radii, nodes, in_view, lit_tile_sizes, node_spacing,
            axes[2], intrinsics, labels.shape, radius_of_pixel, radius_of_block, min_count,
            min_gain, shape_count,
        )  # fmt: skip
