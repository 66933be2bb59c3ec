# mypy: allow-untyped-defs, no-check-untyped-defs
"""Touchdown: first contact of a pad, and the landing outcome.

A terrain raster has heights (rows, cols), bilinear between points; `frame` (3,) holds the
coordinates of post (0, 0) and the posting, m. Terrain outside the posts is unknown.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel


class TouchdownLimit(NamedTuple):
    """Limit on one value of a touchdown.

    `cause` names the violation and `label` the value in figures. `value` is a field of
    `lunarsim.vehicle.touchdown.Touchdown` and `limit` the field of the lander with its maximum. A
    limit of motion is violated if the value exceeds it, a limit of terrain (`is_terrain`) already
    if the value reaches it.
    """

    cause: str
    label: str
    value: str
    limit: str
    is_terrain: bool = False


# In the order of the checks. A limit on a new value also needs its line in `evaluate_touchdown` and
# its field in `lunarsim.vehicle.touchdown.Touchdown`.
LIMITS = (
    TouchdownLimit("vertical-speed", "Vertical speed", "vertical_speed", "vertical_speed_limit"),
    TouchdownLimit(
        "horizontal-speed", "Lateral speed", "horizontal_speed", "horizontal_speed_limit"
    ),
    TouchdownLimit("tilt", "Tilt", "tilt", "tilt_limit"),
    TouchdownLimit("rate", "Angular rate", "rate", "rate_limit"),
    TouchdownLimit("slope", "Slope", "slope", "slope_limit", True),
    TouchdownLimit("roughness", "Roughness", "roughness", "roughness_limit", True),
    TouchdownLimit("belly", "Belly clearance", "roughness", "belly_clearance", True),
)
# Values of a touchdown, and causes of failure: bit k of a result is `CAUSES[k]`.
VALUES = (*dict.fromkeys(limit.value for limit in LIMITS), "tip_margin")
CAUSES = ("off-map", *(limit.cause for limit in LIMITS), "tip-over")
OFF_MAP, _TIP_OVER = 1, 2 << len(LIMITS)
_VERTICAL_SPEED, _HORIZONTAL_SPEED = (
    VALUES.index("vertical_speed"),
    VALUES.index("horizontal_speed"),
)
_TILT, _RATE = VALUES.index("tilt"), VALUES.index("rate")
_SLOPE, _ROUGHNESS, _TIP_MARGIN = (VALUES.index(v) for v in ("slope", "roughness", "tip_margin"))
# Index of each limit's value, and whether it is a limit of terrain.
_LIMITED = np.array([VALUES.index(limit.value) for limit in LIMITS])
_IS_TERRAIN = np.array([limit.is_terrain for limit in LIMITS])


class TouchdownParams(NamedTuple):
    """Properties of lander and gravity for the evaluation of a touchdown, SI.

    `limits` (n,): maximum values in the order of `LIMITS`. `com_height`: height of the centre of
    mass above the pads. `inertia` (2, 3): moments of inertia with empty and full tanks.
    """

    limits: np.ndarray
    com_height: float
    gravity: float
    dry_mass: float
    wet_mass: float
    inertia: np.ndarray


@kernel(exact=True)
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

    `z` and `frame` are those of `height_at`; `disc` (n, 2) are sample points of the pad, m,
    relative to its centre.
    """
    best = -np.inf
    for k in range(len(disc)):
        here = height_at(z, frame, x + disc[k, 0], y + disc[k, 1])
        if not here > -np.inf:
            return np.nan
        best = max(best, here)
    return best


@kernel()
def has_contact(y, pads, disc, z, frame, max_rise):
    """Return whether at least one pad touches the terrain.

    `y` (15,) is the lander's state, `pads` (n, 3) are pad centres in body axes and `disc` (k, 2)
    sample points of a pad, m; `z` and `frame` are those of `height_at`. `max_rise` is an upper
    bound of the terrain under a pad above that under its centre, m; it avoids the samples while
    the pad is higher. Unknown terrain gives no contact.
    """
    at = np.empty(3)
    for k in range(len(pads)):
        body_point(y, pads[k], at)
        if at[2] <= height_at(z, frame, at[0], at[1]) + max_rise and at[2] <= max_pad_height(
            z, frame, at[0], at[1], disc
        ):
            return True
    return False


@kernel()
def _fit_plane(a, b, c, out):
    """Write the plane through three points into `out`: z0, slope east, slope north.

    The points `a`, `b` and `c` (3,) are in m; z0 is the height of the plane at the origin, m.
    """
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    det = ux * vy - uy * vx
    out[1] = (uz * vy - uy * vz) / det
    out[2] = (ux * vz - uz * vx) / det
    out[0] = a[2] - out[1] * a[0] - out[2] * a[1]


@kernel()
def support_planes(legs, planes):
    """Compute the two planes on which a lander can stand; equal for three legs.

    A lander with three legs stands on its three pads. A rigid lander with four legs stands on the
    higher of its two diagonals and one of the other legs. `legs` (3 or 4, 3) are contact points of
    the pads in order around the lander, m. Each row of `planes` (2, 3) is z0, slope east, slope
    north.
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


@kernel(exact=True)
def _inside(x, y, legs):
    """Return whether (x, y) lies in the counter-clockwise polygon `legs` (n, 3)."""
    for k in range(len(legs)):
        a, b = legs[k - 1], legs[k]
        if (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) < 0.0:
            return False
    return True


@kernel()
def samples_between_legs(legs, spacing):
    """Return the points of a grid (k, 2), m, inside the polygon of the legs.

    `legs` (n, 3) are contact points, counter-clockwise, m, of which only the horizontal positions
    are used; `spacing` is that of the grid, m.
    """
    west, east, south, north = legs[0, 0], legs[0, 0], legs[0, 1], legs[0, 1]
    for k in range(1, len(legs)):
        west, east = min(west, legs[k, 0]), max(east, legs[k, 0])
        south, north = min(south, legs[k, 1]), max(north, legs[k, 1])
    rows = int(np.ceil((north + spacing - south) / spacing))
    cols = int(np.ceil((east + spacing - west) / spacing))
    points = np.empty((rows * cols, 2))
    count = 0
    for i in range(rows):
        y, first, end = south + i * spacing, 0, cols
        while first < end and not _inside(west + first * spacing, y, legs):
            first += 1
        while first < end and not _inside(west + (end - 1) * spacing, y, legs):
            end -= 1
        for j in range(first, end):  # the polygon is convex
            points[count, 0], points[count, 1] = west + j * spacing, y
            count += 1
    return points[:count]


@kernel()
def slope_and_roughness(legs, points, heights, out):
    """Compute slope (rad) and roughness (m) of the terrain under a standing lander.

    They follow Eqs. 8 and 9 of the Gaussian DEM paper, as maxima over the planes on which the
    lander can stand. `legs` (n, 3) are contact points, m; `points` (m, 2) are points between them
    with terrain heights `heights` (m,), m. Writes `out` (2,); the roughness is NaN if a height is.
    """
    planes, plane_norm = np.empty((2, 3)), np.empty(2)
    support_planes(legs, planes)
    slope, roughness = 0.0, 0.0
    for p in range(2):
        plane_norm[p] = np.hypot(1.0, np.hypot(planes[p, 1], planes[p, 2]))
        slope = max(slope, np.arccos(1.0 / plane_norm[p]))
    for n in range(len(points)):
        for p in range(2):
            plane = planes[p]
            above = heights[n] - plane[0] - plane[1] * points[n, 0] - plane[2] * points[n, 1]
            if not above / plane_norm[p] <= roughness:  # NaN must propagate
                roughness = above / plane_norm[p]
        if np.isnan(roughness):
            break
    out[0], out[1] = slope, roughness


@kernel()
def tip_margin(y, legs, slope, params):
    """Return the tip-over margin of a touchdown; negative: the lander tips over.

    The margin is the minimum of 1 - E / E_tip over the edges between adjacent legs: the lander hits
    the edge and rotates about it with its angular momentum. The lander tips over if its kinetic
    energy E exceeds E_tip, which lifts the centre of mass over the edge. As a worst case, the
    terrain slopes towards every edge, and the smaller lateral moment of inertia applies to every
    edge. `y` (15,) is the state, `legs` (n, 3) are contact points, m, and `slope` is in rad.
    """
    inertia = params.inertia
    full = (y[13] - params.dry_mass) / (params.wet_mass - params.dry_mass)
    min_inertia = min(
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
        tip_angle = np.arctan2(arm, params.com_height) - slope
        if tip_angle <= 0.0:
            return -np.inf
        length = np.hypot(arm, params.com_height)
        barrier = y[13] * params.gravity * length * (1.0 - np.cos(tip_angle))
        inertia_about_edge = min_inertia + y[13] * length * length
        momentum = y[13] * max(0.0, nx * y[3] + ny * y[4]) * params.com_height
        margin = min(margin, 1.0 - 0.5 * momentum * momentum / inertia_about_edge / barrier)
    return margin


@kernel()
def evaluate_touchdown(y, legs, points, heights, params, out):
    """Evaluate a touchdown; return its violated limits, one bit each (0: safe).

    The bits are those of `CAUSES`. `y` (15,) is the state, `legs` (n, 3) are contact points, and
    `points` (m, 2) and `heights` (m,) the terrain between them, m; unknown heights are NaN.
    `params` is a `TouchdownParams`. `out` receives the values in the order of `VALUES`, SI; those
    of unknown terrain are NaN.
    """
    known = True
    for k in range(len(legs)):
        known = known and np.isfinite(legs[k, 2])
    out[_VERTICAL_SPEED] = -y[5]
    out[_HORIZONTAL_SPEED] = np.hypot(y[3], y[4])
    out[_TILT] = np.arccos(min(max(1.0 - 2.0 * (y[6] * y[6] + y[7] * y[7]), -1.0), 1.0))
    out[_RATE] = np.sqrt(y[10] * y[10] + y[11] * y[11] + y[12] * y[12])
    out[_SLOPE] = out[_ROUGHNESS] = out[_TIP_MARGIN] = np.nan
    if known:
        slope_and_roughness(legs, points, heights, out[_SLOPE : _SLOPE + 2])
        known = np.isfinite(out[_ROUGHNESS])
    if known:
        out[_TIP_MARGIN] = tip_margin(y, legs, out[_SLOPE], params)
    failed = 0 if known else OFF_MAP
    for k in range(len(_LIMITED)):
        value, limit = out[_LIMITED[k]], params.limits[k]
        if value > limit or (_IS_TERRAIN[k] and value == limit):
            failed |= 2 << k
    if out[_TIP_MARGIN] < 0.0:
        failed |= _TIP_OVER
    return failed


@kernel()
def evaluate_on_raster(y, pads, disc, spacing, z, frame, params, out):
    """Evaluate a touchdown on raster terrain, as `evaluate_touchdown` does.

    `pads` (n, 3) are pad centres in body axes and `disc` (k, 2) sample points of a pad, m;
    `spacing` is the distance of terrain samples between the legs, m; `z` and `frame` are those of
    `height_at`.
    """
    legs = np.empty((len(pads), 3))
    for k in range(len(pads)):
        body_point(y, pads[k], legs[k])
        legs[k, 2] = max_pad_height(z, frame, legs[k, 0], legs[k, 1], disc)
    points = samples_between_legs(legs, spacing)
    heights = np.empty(len(points))
    for n in range(len(points)):
        heights[n] = height_at(z, frame, points[n, 0], points[n, 1])
    return evaluate_touchdown(y, legs, points, heights, params, out)
