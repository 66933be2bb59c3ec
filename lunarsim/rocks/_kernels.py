# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled geometry of one rock.

A row of `rocks` is (x, y, base, a, b, height, cos yaw, sin yaw, shape). `planes` and `count` are
the half spaces of the unit shapes (`lunarsim.rocks.shapes`). In the unit axes (e, f, g) of a rock,
e and f are scaled by its semi-axes and g by its height.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def rock_height(x, y, rocks, n, planes, count):
    """Return the elevation (m) of rock n's top at (x, y); -inf outside its outline.

    `rocks` are rows of `RockField.rows`; `planes` and `count` are those of `ShapeTable`.
    """
    dx = x - rocks[n, 0]
    dy = y - rocks[n, 1]
    c = rocks[n, 6]
    s = rocks[n, 7]
    e = (c * dx + s * dy) / rocks[n, 3]
    f = (c * dy - s * dx) / rocks[n, 4]
    shape = int(rocks[n, 8])
    faces = count[shape]
    top = -np.inf
    if faces == 0:
        d = e * e + f * f
        if d < 1.0:
            top = np.sqrt(1.0 - d)
    else:
        top = np.inf
        for k in range(faces):
            room = planes[shape, k, 3] - planes[shape, k, 0] * e - planes[shape, k, 1] * f
            up = planes[shape, k, 2]
            if up > 0.0:
                top = min(top, room / up)
            elif room < 0.0:
                top = -np.inf
                break
    return rocks[n, 2] + rocks[n, 5] * top


@kernel(inner=True)
def rock_normal(x, y, z, rocks, n, planes, count, out):
    """Write the unit outward normal of rock n at (x, y, z) on its surface into `out`.

    `rocks` are rows of `RockField.rows`; `planes` and `count` are those of `ShapeTable`.
    """
    c = rocks[n, 6]
    s = rocks[n, 7]
    dx = x - rocks[n, 0]
    dy = y - rocks[n, 1]
    e = (c * dx + s * dy) / rocks[n, 3]
    f = (c * dy - s * dx) / rocks[n, 4]
    g = (z - rocks[n, 2]) / rocks[n, 5]
    shape = int(rocks[n, 8])
    ne = e
    nf = f
    ng = max(g, 0.0)  # the extension below the base is vertical
    if count[shape] > 0:
        tightest = -np.inf
        for k in range(count[shape]):
            p = planes[shape, k]
            slack = p[0] * e + p[1] * f + p[2] * g - p[3]
            if slack > tightest:
                tightest = slack
                ne = p[0]
                nf = p[1]
                ng = p[2]
    ne /= rocks[n, 3]
    nf /= rocks[n, 4]
    ng /= rocks[n, 5]
    norm = np.sqrt(ne * ne + nf * nf + ng * ng)
    out[0] = (c * ne - s * nf) / norm
    out[1] = (s * ne + c * nf) / norm
    out[2] = ng / norm


@kernel(inline=True)
def _ellipsoid_hit(ex, ey, ez, fx, fy, fz):
    """Return the distance at which a ray enters the unit hemisphere; inf if it misses.

    The ray starts at (ex, ey, ez) in the direction (fx, fy, fz), in unit axes. Below its base the
    hemisphere continues as a vertical cylinder.
    """
    qa = fx * fx + fy * fy + fz * fz
    # Start from the point of closest approach, for precision at long range.
    tc = -(ex * fx + ey * fy + ez * fz) / qa
    ax = ex + tc * fx
    ay = ey + tc * fy
    az = ez + tc * fz
    qc = ax * ax + ay * ay + az * az - 1.0
    hit = np.inf
    if qc < 0.0:
        t = tc - np.sqrt(-qc / qa)
        if ez + t * fz >= 0.0:
            hit = t
    if hit == np.inf:
        # The extension: the outline extruded downwards from the base to the relief.
        wa = fx * fx + fy * fy
        if wa > 0.0:
            tw = -(ax * fx + ay * fy) / wa
            wx = ax + tw * fx
            wy = ay + tw * fy
            wc = wx * wx + wy * wy - 1.0
            if wc < 0.0:
                t = tc + tw - np.sqrt(-wc / wa)
                if ez + t * fz < 0.0:
                    hit = t
    return hit


@kernel(inline=True)
def _polyhedron_hit(ex, ey, ez, fx, fy, fz, planes, faces):
    """Return the distance at which a ray enters a convex polyhedron; inf if it misses.

    The ray starts at (ex, ey, ez) in the direction (fx, fy, fz), in unit axes; the polyhedron is
    the intersection of the first `faces` half spaces of `planes` (n, 4).
    """
    enter = -np.inf
    leave = np.inf
    for k in range(faces):
        speed = planes[k, 0] * fx + planes[k, 1] * fy + planes[k, 2] * fz
        room = planes[k, 3] - (planes[k, 0] * ex + planes[k, 1] * ey + planes[k, 2] * ez)
        if speed < 0.0:
            enter = max(enter, room / speed)
        elif speed > 0.0:
            leave = min(leave, room / speed)
        elif room < 0.0:
            enter = np.inf
        if enter > leave:
            return np.inf
    return enter


@kernel(inline=True, inner=True)
def rock_hit(ox, oy, oz, dx, dy, dz, rocks, n, planes, count):
    """Return the distance, m, at which a ray enters rock n; inf if it misses.

    The ray starts at (ox, oy, oz) in the direction (dx, dy, dz), ENU. `rocks` are rows of
    `RockField.rows`; `planes` and `count` are those of `ShapeTable`.
    """
    c = rocks[n, 6]
    s = rocks[n, 7]
    rx = ox - rocks[n, 0]
    ry = oy - rocks[n, 1]
    ex = (c * rx + s * ry) / rocks[n, 3]
    ey = (c * ry - s * rx) / rocks[n, 4]
    ez = (oz - rocks[n, 2]) / rocks[n, 5]
    fx = (c * dx + s * dy) / rocks[n, 3]
    fy = (c * dy - s * dx) / rocks[n, 4]
    fz = dz / rocks[n, 5]
    shape = int(rocks[n, 8])
    if count[shape] == 0:
        return _ellipsoid_hit(ex, ey, ez, fx, fy, fz)
    return _polyhedron_hit(ex, ey, ez, fx, fy, fz, planes[shape], count[shape])


@kernel()
def cast_on_plane(origin, direction, rocks, planes, count, distance, normal):
    """Intersect rays with rock 0 and the plane z = 0; write distances and normals.

    `origin` and `direction` (n, 3) are the rays; `rocks` are rows of `RockField.rows`; `planes` and
    `count` are those of `ShapeTable`. `distance` (n,), m, and `normal` (n, 3) receive the nearer
    hit. A ray that misses both gets the distance inf and the normal (0, 0, 1).
    """
    for i in range(origin.shape[0]):
        ox, oy, oz = origin[i, 0], origin[i, 1], origin[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        plane_distance = -oz / dz if dz < 0.0 and oz >= 0.0 else np.inf
        hit = rock_hit(ox, oy, oz, dx, dy, dz, rocks, 0, planes, count)
        # Hits below the plane do not count; the tolerance accepts a ray that starts on the rock.
        if hit >= -1e-9 and hit < plane_distance:
            distance[i] = hit
            rock_normal(
                ox + hit * dx, oy + hit * dy, oz + hit * dz, rocks, 0, planes, count, normal[i]
            )
        else:
            distance[i] = plane_distance
            normal[i, 0] = 0.0
            normal[i, 1] = 0.0
            normal[i, 2] = 1.0
