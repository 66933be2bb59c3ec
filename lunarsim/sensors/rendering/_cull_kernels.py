# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled selection of the rocks to draw.

A row of `rocks` is (x, y, base, a, b, height, cos yaw, sin yaw, shape); `reach` is the radius of a
rock's outline and `foot` is the elevation down to which its sides are drawn.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.models._pinhole_kernels import to_pixel


@kernel(parallel=True)
def rock_feet(rocks, reach, z, x0, y0, p):
    """Return an elevation (n,), m, that is below all relief under each rock's outline.

    `reach` (n,) are the radii of the outlines, m; `z` are the elevations of the relief, with the
    first grid point (x0, y0) and the spacing `p`.
    """
    rows, cols = z.shape
    foot = np.empty(rocks.shape[0])
    for n in prange(rocks.shape[0]):
        lowest = rocks[n, 2]
        j0 = max(int(np.floor((rocks[n, 0] - reach[n] - x0) / p)), 0)
        j1 = min(int(np.ceil((rocks[n, 0] + reach[n] - x0) / p)), cols - 1)
        i0 = max(int(np.floor((rocks[n, 1] - reach[n] - y0) / p)), 0)
        i1 = min(int(np.ceil((rocks[n, 1] + reach[n] - y0) / p)), rows - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                lowest = min(lowest, np.float64(z[i, j]))
        foot[n] = lowest - 0.01
    return foot


@kernel(exact=True)
def _half_sides(rocks, n, reach):
    """Return half of the side vectors of the rectangle around rock n's outline.

    The result is four numbers s0 to s3, m: the vectors are (s0, s1) and (-s2, s3), east and north.
    `reach` (n,) are the radii of the outlines, m.
    """
    scale = reach[n] / max(rocks[n, 3], rocks[n, 4])
    e = rocks[n, 3] * scale
    f = rocks[n, 4] * scale
    return rocks[n, 6] * e, rocks[n, 7] * e, rocks[n, 7] * f, rocks[n, 6] * f


@kernel()
def _write_pixel_box(u0, v0, u1, v1, width, height, box, m):
    """Write the box of the pixels whose centres lie in a rectangle into `box[m]`.

    The rectangle spans columns u0 to u1 and rows v0 to v1 of an image of `width` x `height`. The
    box is minimum column, minimum row, maximum column and maximum row. Returns False if it contains
    no pixel; `box[m]` is then meaningless. Centres are at integers. A margin of 0.005 pixels allows
    for rounding of float32 in the shader.
    """
    u0 = max(np.ceil(u0 - 0.005), 0.0)
    v0 = max(np.ceil(v0 - 0.005), 0.0)
    u1 = min(np.floor(u1 + 0.005), width - 1.0)
    v1 = min(np.floor(v1 + 0.005), height - 1.0)
    box[m, 0] = u0 - 0.5
    box[m, 1] = v0 - 0.5
    box[m, 2] = u1 + 0.5
    box[m, 3] = v1 + 0.5
    return u0 <= u1 and v0 <= v1


@kernel()
def visible_rocks(
    rocks, reach, foot, rock_indices, viewpoint, to_sensor, fx, fy, cx, cy, width, height, near
):
    """Return the pixel box of each tested rock, and whether it contains a pixel.

    The boxes (m, 4) contain all pixels that a rock may cover: minimum column, minimum row, maximum
    column and maximum row. The flags (m,) are False for rocks that cover no pixel; their boxes are
    undefined. `rocks`, `reach` and `foot` are those of `RockTiles`; `rock_indices` (m,) selects the
    rocks. `viewpoint` (3,) is the camera, `to_sensor` (3, 3) the rotation from ENU, `fx` to `cy`
    are the focal lengths and principal point, `width` x `height` is the image size, pixels, and
    `near` the minimum depth, m.
    """
    count = rock_indices.size
    seen = np.zeros(count, np.bool_)
    box = np.empty((count, 4))
    left = np.hypot(fx, cx + 0.5)
    right = np.hypot(fx, width - 0.5 - cx)
    upper = np.hypot(fy, cy + 0.5)
    lower = np.hypot(fy, height - 0.5 - cy)
    for m in range(count):
        n = rock_indices[m]
        dx = rocks[n, 0] - viewpoint[0]
        dy = rocks[n, 1] - viewpoint[1]
        dz = rocks[n, 2] - viewpoint[2]
        sx = to_sensor[0, 0] * dx + to_sensor[0, 1] * dy + to_sensor[0, 2] * dz
        sy = to_sensor[1, 0] * dx + to_sensor[1, 1] * dy + to_sensor[1, 2] * dz
        sz = to_sensor[2, 0] * dx + to_sensor[2, 1] * dy + to_sensor[2, 2] * dz
        # Test a sphere that contains the rock against the sides of the view.
        ball = 1.5 * reach[n] + max(rocks[n, 5], rocks[n, 2] - foot[n])
        outside = (
            sz < near - ball
            or fx * sx + (cx + 0.5) * sz < -ball * left
            or fx * sx - (width - 0.5 - cx) * sz > ball * right
            or fy * sy + (cy + 0.5) * sz < -ball * upper
            or fy * sy - (height - 0.5 - cy) * sz > ball * lower
        )
        if outside:
            continue
        sides = _half_sides(rocks, n, reach)
        top = rocks[n, 2] + rocks[n, 5] - viewpoint[2]
        base = foot[n] - viewpoint[2]
        u0 = np.inf
        u1 = -np.inf
        v0 = np.inf
        v1 = -np.inf
        for k in range(8):
            e = 1.0 if k & 1 else -1.0
            f = 1.0 if k & 2 else -1.0
            x = rocks[n, 0] + e * sides[0] - f * sides[2] - viewpoint[0]
            y = rocks[n, 1] + e * sides[1] + f * sides[3] - viewpoint[1]
            z = top if k & 4 else base
            sz = to_sensor[2, 0] * x + to_sensor[2, 1] * y + to_sensor[2, 2] * z
            if sz < 0.02:  # extends behind the camera: may cover any pixel
                u0 = 0.0
                v0 = 0.0
                u1 = width
                v1 = height
                break
            sx = to_sensor[0, 0] * x + to_sensor[0, 1] * y + to_sensor[0, 2] * z
            sy = to_sensor[1, 0] * x + to_sensor[1, 1] * y + to_sensor[1, 2] * z
            u, v = to_pixel(sx, sy, sz, fx, fy, cx, cy)
            u0 = min(u0, u)
            u1 = max(u1, u)
            v0 = min(v0, v)
            v1 = max(v1, v)
        seen[m] = _write_pixel_box(u0, v0, u1, v1, width, height, box, m)
    return box, seen


@kernel()
def _is_read(u0, v0, u1, v1, width, height, normal, lower_bound, upper_bound):
    """Return whether a box of shadow map texels may be read by the image.

    The box spans columns u0 to u1 and rows v0 to v1 of a map of `width` x `height`. Texels are read
    in strips with normals `normal` (k, 2) between `lower_bound` and `upper_bound` (k,), and at the
    border of the map.
    """
    # Same rule as `ShadowMapReads.may_shade`.
    if u0 < 4.0 or v0 < 4.0 or u1 > width - 4.0 or v1 > height - 4.0:
        return True
    for k in range(lower_bound.size):
        a = normal[k, 0]
        b = normal[k, 1]
        if max(a * u0, a * u1) + max(b * v0, b * v1) < lower_bound[k]:
            return False
        if min(a * u0, a * u1) + min(b * v0, b * v1) > upper_bound[k]:
            return False
    return True


@kernel()
def shadow_casting_rocks(
    rocks,
    reach,
    foot,
    rock_indices,
    viewpoint,
    lean,
    axes,
    corner,
    texel,
    width,
    height,
    normal,
    lower_bound,
    upper_bound,
):
    """Return the texel box of each tested rock, and whether the image reads it.

    The boxes (m, 4) contain all texels of the shadow map that a rock may shadow: minimum column,
    minimum row, maximum column and maximum row. The flags (m,) are False for rocks that shadow no
    texel that the image reads. `rocks`, `reach` and `foot` are those of `RockTiles`; `rock_indices`
    (m,) selects the rocks. `viewpoint` (3,) is the camera. `lean` (2,) is the displacement of the
    Sun's rays per metre of height, `axes` (2, 2) transforms ENU to the axes of the shadow map,
    `corner` is the map's corner in these axes, m, and `texel` the side of a texel, m; the map has
    `width` x `height` texels. The image reads the strips of `ShadowMapReads` (`normal`,
    `lower_bound`, `upper_bound`) and the border of the map.
    """
    count = rock_indices.size
    seen = np.zeros(count, np.bool_)
    box = np.empty((count, 4))
    for m in range(count):
        n = rock_indices[m]
        sides = _half_sides(rocks, n, reach)
        u0 = np.inf
        u1 = -np.inf
        v0 = np.inf
        v1 = -np.inf
        for high in range(2):
            z = (rocks[n, 2] + rocks[n, 5] if high else foot[n]) - viewpoint[2]
            shift_x = viewpoint[0] + z * lean[0]
            shift_y = viewpoint[1] + z * lean[1]
            for k in range(4):
                e = 1.0 if k & 1 else -1.0
                f = 1.0 if k & 2 else -1.0
                x = rocks[n, 0] + e * sides[0] - f * sides[2] - shift_x
                y = rocks[n, 1] + e * sides[1] + f * sides[3] - shift_y
                u = axes[0, 0] * x + axes[0, 1] * y - corner[0]
                v = axes[1, 0] * x + axes[1, 1] * y - corner[1]
                u0 = min(u0, u)
                u1 = max(u1, u)
                v0 = min(v0, v)
                v1 = max(v1, v)
        # Division by a positive number preserves the order.
        u0 /= texel
        u1 /= texel
        v0 /= texel
        v1 /= texel
        # Centres of texels are at half integers.
        seen[m] = _write_pixel_box(
            u0 - 0.5, v0 - 0.5, u1 - 0.5, v1 - 0.5, width, height, box, m
        ) and _is_read(u0, v0, u1, v1, width, height, normal, lower_bound, upper_bound)
    return box, seen


@kernel()
def select_boxes(box, rock_indices, drawn):
    """Return the boxes (k, 4), float32, and the indices (k,) of the rocks to be drawn.

    `box` (m, 4) and `rock_indices` (m,) are those of all tested rocks; `drawn` (m,) selects k
    rocks.
    """
    picked = np.flatnonzero(drawn)
    out = np.empty((picked.size, 4), np.float32)
    for m in range(picked.size):
        for k in range(4):
            out[m, k] = box[picked[m], k]
    return out, rock_indices[picked]


@kernel()
def box_corners(box, rock_indices, selected):
    """Return the corners of the selected boxes, with the rock's index, for OpenGL.

    `selected` (k,) are positions in `box` (m, 4) and `rock_indices` (m,). The result (4 k, 3),
    float32, has column, row and rock index of the corners lower left, lower right, upper left and
    upper right of each box. Columns and rows are relative to the image's corner.
    """
    out = np.empty((4 * selected.size, 3), np.float32)
    for m in range(selected.size):
        n = selected[m]
        for k in range(4):
            # The centre of the first pixel is at 0.
            out[4 * m + k, 0] = box[n, 2 * (k % 2)] + 0.5
            out[4 * m + k, 1] = box[n, 1 + 2 * (k // 2)] + 0.5
            out[4 * m + k, 2] = rock_indices[n]
    return out
