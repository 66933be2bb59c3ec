# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled drawing of rocks that cover a few pixels.

A software OpenGL driver shades 16 pixels to draw one. Small rocks are therefore ray traced here,
with the geometry of the ray caster, and passed to OpenGL as points. This runs on one thread: the
rays of an image take 1 to 2 ms, and waiting threads would take processor time from the driver,
which draws at the same time.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.models._pinhole_kernels import to_tangents
from lunarsim.rocks._kernels import rock_hit, rock_normal

MOST = 16  # maximum number of pixels in a small rock's box


@kernel()
def split_by_size(box):
    """Separate the screen boxes (m, 4) of small rocks from those of large rocks.

    Returns the indices (k,) of the boxes of at most 16 pixels, the start of each of these boxes in
    a list of all their pixels (k + 1,), and the indices of the other boxes. The last start is the
    number of pixels in the list.
    """
    area = np.empty(box.shape[0], np.int64)
    for m in range(box.shape[0]):
        area[m] = round((box[m, 2] - box[m, 0]) * (box[m, 3] - box[m, 1]))
    small = np.flatnonzero(area <= MOST)
    start = np.zeros(small.size + 1, np.int64)
    start[1:] = np.cumsum(area[small])
    return small, start, np.flatnonzero(area > MOST)


@kernel()
def trace_view_rays(
    rocks,
    planes,
    count,
    box,
    rock_indices,
    small,
    start,
    viewpoint,
    to_sensor,
    fx,
    fy,
    cx,
    cy,
    near,
):
    """Trace a ray through every pixel of small rocks in an image.

    `rocks`, `planes` and `count` are rocks (n, 9) and the half spaces of their shapes; `box` and
    `rock_indices` are those of `DrawnRocks`, `small` and `start` results of `split_by_size`.
    `viewpoint` (3,) is the camera, `to_sensor` (3, 3) the rotation from ENU, `fx` to `cy` are the
    focal lengths and principal point, and `near` is the minimum depth, m. Returns one row per pixel
    (k, 7), float32: column, row, depth, normal (3) and rock index; and whether its ray hits the
    rock (k,). Rows without a hit are undefined.
    """
    out = np.empty((start[-1], 7), np.float32)
    hit = np.zeros(start[-1], np.bool_)
    for k in range(small.size):
        m = small[k]
        n = rock_indices[m]
        normal = np.empty(3)
        at = start[k]
        wide = round(box[m, 2] - box[m, 0])
        for p in range(start[k + 1] - at):
            u = np.float64(box[m, 0]) + 0.5 + p % wide
            v = np.float64(box[m, 1]) + 0.5 + p // wide
            sx, sy = to_tangents(u, v, fx, fy, cx, cy)
            dx = to_sensor[0, 0] * sx + to_sensor[1, 0] * sy + to_sensor[2, 0]
            dy = to_sensor[0, 1] * sx + to_sensor[1, 1] * sy + to_sensor[2, 1]
            dz = to_sensor[0, 2] * sx + to_sensor[1, 2] * sy + to_sensor[2, 2]
            t = rock_hit(
                viewpoint[0], viewpoint[1], viewpoint[2], dx, dy, dz, rocks, n, planes, count
            )
            if not (t >= near and t < np.inf):
                continue
            rock_normal(
                viewpoint[0] + t * dx,
                viewpoint[1] + t * dy,
                viewpoint[2] + t * dz,
                rocks,
                n,
                planes,
                count,
                normal,
            )
            row = out[at + p]
            row[0] = u
            row[1] = v
            row[2] = t
            row[3] = normal[0]
            row[4] = normal[1]
            row[5] = normal[2]
            row[6] = n
            hit[at + p] = True
    return out, hit


@kernel()
def trace_sun_rays(
    rocks,
    planes,
    count,
    box,
    rock_indices,
    small,
    start,
    viewpoint,
    lean,
    axes,
    corner,
    texel,
    highest,
    lowest,
):
    """Trace a ray to the Sun through every shadow map texel of small rocks.

    `rocks`, `planes` and `count` are rocks (n, 9) and the half spaces of their shapes; `box` and
    `rock_indices` are those of `DrawnRocks`, `small` and `start` results of `split_by_size`.
    `viewpoint` (3,) is the camera. `lean`, `axes`, `corner` and `texel` describe the map as in
    `ShadowFrame`; `highest` and `lowest` bound elevations relative to the camera, m. Returns one
    row per texel (k, 3), float32: column, row and depth (0 to 1) of the point where a ray from the
    Sun leaves the rock; and whether the ray hits the rock (k,). Rows without a hit are undefined.
    """
    out = np.empty((start[-1], 3), np.float32)
    hit = np.zeros(start[-1], np.bool_)
    for k in range(small.size):
        m = small[k]
        n = rock_indices[m]
        at = start[k]
        wide = round(box[m, 2] - box[m, 0])
        for p in range(start[k + 1] - at):
            u = np.float64(box[m, 0]) + 0.5 + p % wide
            v = np.float64(box[m, 1]) + 0.5 + p // wide
            a = corner[0] + texel * (u + 0.5)
            b = corner[1] + texel * (v + 0.5)
            x = viewpoint[0] + axes[0, 0] * a + axes[1, 0] * b
            y = viewpoint[1] + axes[0, 1] * a + axes[1, 1] * b
            # The ray points to the Sun: where it enters the rock, a ray from the Sun leaves it.
            t = rock_hit(x, y, viewpoint[2], lean[0], lean[1], 1.0, rocks, n, planes, count)
            if t == np.inf:
                continue
            row = out[at + p]
            row[0] = u
            row[1] = v
            row[2] = min(max((highest - t) / (highest - lowest), 0.0), 1.0)
            hit[at + p] = True
    return out, hit


@kernel()
def min_depth(points, hit, height, width):
    """Return an image (height, width), float32, of the minimum depth of hits.

    `points` (m, 3) are column, row and depth; only those with `hit` (m,) count. Pixels without a
    hit have the depth 1.
    """
    out = np.empty((height, width), np.float32)
    for i in range(height):
        out[i] = 1.0
    for n in range(len(points)):
        if hit[n]:
            i = int(points[n, 1])
            j = int(points[n, 0])
            out[i, j] = min(out[i, j], points[n, 2])
    return out
