# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled touchdown on raster terrain: first contact and landing outcome.

Terrain is a raster of heights (rows, cols), bilinear between points; `frame` (3,) holds the
coordinates of post (0, 0) and the posting, m. Terrain outside the posts is unknown.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

# Bits of the violated limits, in the order of `evaluate_touchdown`.
OFF_MAP, VERTICAL_SPEED, HORIZONTAL_SPEED, TILT, RATE = 1, 2, 4, 8, 16
SLOPE, ROUGHNESS, BELLY, TIP_OVER = 32, 64, 128, 256


@kernel()
def height_at(z, frame, x, y):
    """Interpolate the height, m, of a terrain raster at (x, y); NaN outside its grid.

    `z` (rows, cols) are heights, m; `frame` (3,) is the position east and north of grid point
    z[0, 0], and the spacing, m.
    """
    rows, cols = z.shape
    u = (x - frame[0]) / frame[2]
    v = (y - frame[1]) / frame[2]
    if not (0.0 <= u <= cols - 1 and 0.0 <= v <= rows - 1):
        return np.nan
    j = min(int(u), cols - 2)
    i = min(int(v), rows - 2)
    a, b = u - j, v - i
    low = (1.0 - a) * z[i, j] + a * z[i, j + 1]
    high = (1.0 - a) * z[i + 1, j] + a * z[i + 1, j + 1]
    return (1.0 - b) * low + b * high


@kernel()
def body_point(y, pad, out):
    """Write the ENU position of a point fixed to the body into `out` (3,), m.

    `y` (15,) is the lander's state and `pad` (3,) the point in body axes, m.
    """
    qx, qy, qz, qw = y[6], y[7], y[8], y[9]
    cx = qy * pad[2] - qz * pad[1] + qw * pad[0]
    cy = qz * pad[0] - qx * pad[2] + qw * pad[1]
    cz = qx * pad[1] - qy * pad[0] + qw * pad[2]
    out[0] = y[0] + pad[0] + 2.0 * (qy * cz - qz * cy)
    out[1] = y[1] + pad[1] + 2.0 * (qz * cx - qx * cz)
    out[2] = y[2] + pad[2] + 2.0 * (qx * cy - qy * cx)


@kernel()
def max_pad_height(z, frame, x, y, disc):
    """Return the maximum terrain height, m, under a pad at (x, y); NaN where unknown.

    `z` and `frame` are the terrain raster; `disc` (n, 2) are sample points of the pad, m.
    """
    best = -np.inf
    for k in range(len(disc)):
        here = height_at(z, frame, x + disc[k, 0], y + disc[k, 1])
        if not here > -np.inf:
            return np.nan
        best = max(best, here)
    return best


@kernel()
def has_contact(y, pads, disc, z, frame):
    """Return whether any pad touches the terrain.

    `y` (15,) is the lander's state, `pads` (n, 3) are pad centres in body axes and `disc` (k, 2)
    sample points of a pad, m; `z` and `frame` are the terrain raster.
    """
    at = np.empty(3)
    for k in range(len(pads)):
        body_point(y, pads[k], at)
        # Most of the flight is far above the terrain: a check at the centre avoids the disc.
        if at[2] <= height_at(z, frame, at[0], at[1]) + 2.0 and at[2] <= max_pad_height(
            z, frame, at[0], at[1], disc
        ):
            return True
    return False


@kernel()
def _fit_plane(a, b, c, out):
    """Write the plane through three points into `out`: z0, slope east, slope north."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    det = ux * vy - uy * vx
    out[1] = (uz * vy - uy * vz) / det
    out[2] = (ux * vz - uz * vx) / det
    out[0] = a[2] - out[1] * a[0] - out[2] * a[1]


@kernel()
def write_support_planes(legs, planes):
    """Compute the two planes on which a lander can stand; equal for three legs.

    `legs` (3 or 4, 3) are contact points of the pads, m. Each row of `planes` (2, 3) is z0, slope
    east, slope north. The rule is that of `touchdown.support_planes`.
    """
    if len(legs) == 3:
        _fit_plane(legs[0], legs[1], legs[2], planes[0])
        _fit_plane(legs[0], legs[1], legs[2], planes[1])
    elif legs[0, 2] + legs[2, 2] >= legs[1, 2] + legs[3, 2]:
        _fit_plane(legs[0], legs[1], legs[2], planes[0])
        _fit_plane(legs[0], legs[2], legs[3], planes[1])
    else:
        _fit_plane(legs[0], legs[1], legs[3], planes[0])
        _fit_plane(legs[1], legs[2], legs[3], planes[1])


@kernel()
def _inside(x, y, legs):
    """Return whether (x, y) lies in the counter-clockwise polygon `legs` (n, 3)."""
    n = len(legs)
    for k in range(n):
        a, b = legs[k], legs[(k + 1) % n]
        if (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) < 0.0:
            return False
    return True


@kernel()
def fit_terrain(legs, spacing, z, frame, out):
    """Compute slope (rad) and roughness (m) of the terrain under a standing lander.

    `legs` (n, 3) are contact points of the pads, m, and `spacing` is the distance of terrain
    samples, m; `z` and `frame` are the terrain raster. The results, written into `out` (2,), are
    those of `touchdown.fit_terrain_plane`.
    """
    planes = np.empty((2, 3))
    write_support_planes(legs, planes)
    n = len(legs)
    west, east, south, north = legs[0, 0], legs[0, 0], legs[0, 1], legs[0, 1]
    for k in range(1, n):
        west, east = min(west, legs[k, 0]), max(east, legs[k, 0])
        south, north = min(south, legs[k, 1]), max(north, legs[k, 1])
    slope, rough = 0.0, 0.0
    plane_norm = np.empty(2)
    for p in range(len(planes)):
        plane_norm[p] = np.hypot(1.0, np.hypot(planes[p, 1], planes[p, 2]))
        slope = max(slope, np.arccos(1.0 / plane_norm[p]))
    for i in range(int(np.ceil((north + spacing - south) / spacing))):
        y = south + i * spacing
        for j in range(int(np.ceil((east + spacing - west) / spacing))):
            x = west + j * spacing
            if not _inside(x, y, legs):
                continue
            terrain_height = height_at(z, frame, x, y)
            for p in range(2):
                above = terrain_height - planes[p, 0] - planes[p, 1] * x - planes[p, 2] * y
                if not above / plane_norm[p] <= rough:  # NaN must propagate
                    rough = above / plane_norm[p]
            if np.isnan(rough):
                out[0], out[1] = slope, rough
                return
    out[0] = slope
    out[1] = rough


@kernel()
def tip_margin(y, legs, slope, com_height, gravity, dry, wet, inertia):
    """Return the minimum tip-over margin over the edges between adjacent legs.

    The margin is 1 - E / E_tip of `touchdown.tip_margin`; negative: the lander tips over. `y` (15,)
    is the state, `legs` (n, 3) are contact points, m, `slope` is in rad; `dry`, `wet` and `inertia`
    (2, 3) are masses and moments of inertia with tanks empty and full.
    """
    full = (y[13] - dry) / (wet - dry)
    least = min(
        inertia[0, 0] + full * (inertia[1, 0] - inertia[0, 0]),
        inertia[0, 1] + full * (inertia[1, 1] - inertia[0, 1]),
    )
    n = len(legs)
    margin = np.inf
    for i in range(n):
        j = (i + 1) % n
        ex, ey = legs[j, 0] - legs[i, 0], legs[j, 1] - legs[i, 1]
        edge_length = np.hypot(ex, ey)
        nx, ny = ey / edge_length, -ex / edge_length
        arm = nx * (legs[i, 0] - y[0]) + ny * (legs[i, 1] - y[1])
        if arm < 0.0:
            nx, ny, arm = -nx, -ny, -arm
        tip_angle = np.arctan2(arm, com_height) - slope
        if tip_angle <= 0.0:
            return -np.inf
        length = np.hypot(arm, com_height)
        barrier = y[13] * gravity * length * (1.0 - np.cos(tip_angle))
        inertia_about_edge = least + y[13] * length * length
        momentum = y[13] * max(0.0, nx * y[3] + ny * y[4]) * com_height
        margin = min(margin, 1.0 - 0.5 * momentum * momentum / inertia_about_edge / barrier)
    return margin


@kernel()
def violated_limits(
    y, pads, disc, spacing, z, frame, limits, com_height, gravity, dry, wet, inertia, out
):
    """Evaluate a touchdown; return its violated limits, one bit each (0: safe).

    `limits` (7,) are those of vertical and horizontal speed, tilt, angular rate, slope, roughness
    and belly clearance, SI. `out` (7,) receives the values, with the tip-over margin in the last
    place. The other arguments are those of `has_contact`, `fit_terrain` and `tip_margin`.
    """
    n = len(pads)
    legs = np.empty((n, 3))
    known = True
    for k in range(n):
        body_point(y, pads[k], legs[k])
        legs[k, 2] = max_pad_height(z, frame, legs[k, 0], legs[k, 1], disc)
        known = known and not np.isnan(legs[k, 2])
    out[0] = -y[5]
    out[1] = np.hypot(y[3], y[4])
    out[2] = np.arccos(min(max(1.0 - 2.0 * (y[6] * y[6] + y[7] * y[7]), -1.0), 1.0))
    out[3] = np.sqrt(y[10] * y[10] + y[11] * y[11] + y[12] * y[12])
    out[4] = out[5] = out[6] = np.nan
    if known:
        fit_terrain(legs, spacing, z, frame, out[4:6])
        known = not np.isnan(out[5])
    if known:
        out[6] = tip_margin(y, legs, out[4], com_height, gravity, dry, wet, inertia)
    failed = 0 if known else OFF_MAP
    for k in range(4):
        if out[k] > limits[k]:
            failed |= 2 << k
    if out[4] >= limits[4]:
        failed |= SLOPE
    if out[5] >= limits[5]:
        failed |= ROUGHNESS
    if out[5] >= limits[6]:
        failed |= BELLY
    if out[6] < 0.0:
        failed |= TIP_OVER
    return failed
