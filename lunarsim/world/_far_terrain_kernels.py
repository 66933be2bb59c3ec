# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled heights, ray casting and shadows of the terrain beyond the map.

`surface` is a `Surface`: the map and the levels around it. Points are located by arc lengths east
and north of the map's origin, m; on flat terrain these are the coordinates themselves.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.world.terrain._surface_kernels import relief_at

# Bisections of the interval with a first hit: below 1 mm for intervals up to 8 km.
_BISECTIONS = 23
# Distance between samples over distance from the start. On a slope of 30 deg, a summit between two
# samples is missed by at most 0.5 * tan(30 deg) of it, 0.017 deg.
STEP_RATIO = 1e-3
# Step over clearance. No hit is missed on slopes up to 45 deg.
_STEP_PER_CLEARANCE = 0.5
_MAX_STEPS = 1_000_000


class Surface(NamedTuple):
    """Arrays of the map and of the levels around it.

    Attributes
    ----------
    z, frame
        Elevations of the map (rows, cols), and its first point (x, y) and spacing, m (3,).
    levels, table
        Heights of all levels, one after the other, m. For each level (n, 7): first point (x, y),
        spacing, rows, columns, index of its first height, and half the side at which it fades out
        (infinite: it does not).
    margin, strip
        Width of the fading strip over half the side, and width of the strip around the map in
        which heights change to those of the levels, m.
    radius
        Radius of the Moon, m; 0: flat.
    top, extent
        Height that no terrain exceeds, and distance from the origin along each axis beyond which
        all heights are 0, m.
    finest
        Smallest spacing of a level, m.
    """

    z: Any
    frame: Any
    levels: Any
    table: Any
    margin: Any
    strip: Any
    radius: Any
    top: Any
    extent: Any
    finest: Any


@kernel()
def _smoothstep(x):
    """Return 1 - 3 x^2 + 2 x^3 for 0 < x < 1; 1 below and 0 above."""
    s = min(max(x, 0.0), 1.0)
    return 1.0 - s * s * (3.0 - 2.0 * s)


@kernel()
def _level_sum(x, y, levels, table, margin):
    """Return the sum of the heights of all levels at an arc (x, y), m."""
    total = 0.0
    for n in range(table.shape[0]):
        half = table[n, 6]
        share = _smoothstep((max(abs(x), abs(y)) / half - 1.0) / margin + 1.0)
        u = (x - table[n, 0]) / table[n, 2]
        v = (y - table[n, 1]) / table[n, 2]
        rows = int(table[n, 3])
        cols = int(table[n, 4])
        # Written so that NaN coordinates fail the test.
        if not (share > 0.0 and u >= 0.0 and v >= 0.0 and u <= cols - 1 and v <= rows - 1):
            continue
        j = min(int(u), cols - 2)
        i = min(int(v), rows - 2)
        u -= j
        v -= i
        k = int(table[n, 5]) + i * cols + j
        low = levels[k] * (1.0 - u) + levels[k + 1] * u
        high = levels[k + cols] * (1.0 - u) + levels[k + cols + 1] * u
        total += share * (low * (1.0 - v) + high * v)
    return total


@kernel()
def _height(x, y, surface):
    """Return the height, m, of the surface at an arc (x, y); NaN if unknown."""
    z, frame, levels, table, margin, strip, radius, _, _, _ = surface
    ex = min(max(x, frame[0]), frame[0] + (z.shape[1] - 1) * frame[2])
    ey = min(max(y, frame[1]), frame[1] + (z.shape[0] - 1) * frame[2])
    beyond = np.hypot(x - ex, y - ey)
    share = _smoothstep(beyond / strip)
    height = 0.0
    if share > 0.0:
        height = relief_at(ex, ey, z, frame[0], frame[1], frame[2])
        if radius > 0.0:
            height += (ex * ex + ey * ey) / (2.0 * radius)
        if beyond == 0.0:
            return height
        if np.isnan(height):
            share = 0.0
            height = 0.0
    return share * height + (1.0 - share) * _level_sum(x, y, levels, table, margin)


@kernel()
def _place(x, y, z, radius):
    """Return arc (x, y) and height above the sphere, m, of a position, ENU, m."""
    if radius == 0.0:
        return x, y, z
    lateral = np.hypot(x, y)
    arc = radius * np.arctan2(lateral, z + radius)
    scale = arc / max(lateral, 1e-12)
    return x * scale, y * scale, np.hypot(lateral, z + radius) - radius


@kernel()
def _clearance(x, y, z, surface):
    """Return the height of a position, ENU, m, above the surface."""
    ax, ay, height = _place(x, y, z, surface.radius)
    return height - _height(ax, ay, surface)


@kernel()
def _first_hit(o, d, max_range, surface):
    """Return the range, m, of the first hit of a ray; NaN if it misses.

    The ray starts at `o` (3,) in the direction `d` (3,), ENU, m. If it starts below the surface, or
    comes out of the terrain, it hits nothing.
    """
    radius = surface.radius
    t = 0.0
    clear = _clearance(o[0], o[1], o[2], surface)
    if clear <= 0.0:
        return np.nan
    for _ in range(_MAX_STEPS):
        x = o[0] + t * d[0]
        y = o[1] + t * d[1]
        z = o[2] + t * d[2]
        height = z
        climb = d[2]
        if radius > 0.0:
            distance = np.sqrt(x * x + y * y + (z + radius) ** 2)
            height = distance - radius
            climb = (x * d[0] + y * d[1] + (z + radius) * d[2]) / distance
        is_outside = height > surface.top or (
            radius == 0.0 and max(abs(x), abs(y)) > surface.extent and clear > 0.0
        )
        if t >= max_range or (climb >= 0.0 and is_outside):
            return np.nan
        step = max(0.25 * surface.finest, STEP_RATIO * t)
        if not np.isnan(clear):
            step = max(step, _STEP_PER_CLEARANCE * clear)
        ahead = min(t + step, max_range)
        now = _clearance(o[0] + ahead * d[0], o[1] + ahead * d[1], o[2] + ahead * d[2], surface)
        if now <= 0.0:
            if np.isnan(clear):
                return np.nan
            for _ in range(_BISECTIONS):
                middle = 0.5 * (t + ahead)
                now = _clearance(
                    o[0] + middle * d[0], o[1] + middle * d[1], o[2] + middle * d[2], surface
                )
                if now > 0.0:
                    t = middle
                else:
                    ahead = middle
            return 0.5 * (t + ahead)
        t = ahead
        clear = now
    return np.nan


@kernel()
def _terrain_height(x, y, z, surface):
    """Return the height of the surface below a position, ENU, m."""
    ax, ay, _ = _place(x, y, z, surface.radius)
    return _height(ax, ay, surface)


@kernel()
def _write_normal(p, surface, out):
    """Write the unit normal (3,), ENU, of the surface below `p` (3,), ENU, m.

    It is computed from differences over 1 m.
    """
    radius = surface.radius
    out[:] = 0.0
    out[2] = 1.0
    if radius > 0.0:
        distance = np.sqrt(p[0] ** 2 + p[1] ** 2 + (p[2] + radius) ** 2)
        out[0] = p[0] / distance
        out[1] = p[1] / distance
        out[2] = (p[2] + radius) / distance
    for k in range(3):
        dx = 0.5 if k == 0 else 0.0
        dy = 0.5 if k == 1 else 0.0
        dz = 0.5 if k == 2 else 0.0
        out[k] -= _terrain_height(p[0] + dx, p[1] + dy, p[2] + dz, surface) - _terrain_height(
            p[0] - dx, p[1] - dy, p[2] - dz, surface
        )
    size = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    for k in range(3):
        out[k] /= size


@kernel(shared=True)
def cast(thread_slice, origin, direction, max_range, surface, distance, normal):
    """Write range (n,), m, and unit normal (n, 3) of the first hit of each ray.

    `origin` (1 or n, 3) and `direction` (n, 3) are the rays, ENU, and `max_range` is the maximum
    range, m. Range and normal of a miss are NaN. `thread_slice` is (thread, number of threads).
    """
    point = np.empty(3)
    for n in range(thread_slice[0], direction.shape[0], thread_slice[1]):
        o = origin[n if origin.shape[0] > 1 else 0]
        distance[n] = _first_hit(o, direction[n], max_range, surface)
        if np.isnan(distance[n]):
            normal[n, :] = np.nan
            continue
        for k in range(3):
            point[k] = o[k] + distance[n] * direction[n, k]
        _write_normal(point, surface, normal[n])


@kernel(shared=True)
def sweep_shadow(thread_slice, across, start, reach, towards, slope, surface, shadow, place):
    """Find the terrain beyond the map that casts the highest shadow on lines.

    The lines lead towards the Sun. Line n has the coordinate `across[n]`, m, to the left of the
    horizontal direction `towards` (2,) to the Sun. It is sampled from `start[n]`, where it leaves
    the map, to `reach`, m. `slope`, more than 0, is the tangent of the Sun's elevation. The height
    of a shadow, m, at a distance s along the line is `shadow[n] + s * slope`; `place[n]`, m, is the
    distance of the terrain that casts it. `thread_slice` is (thread, number of threads).
    """
    radius = surface.radius
    for n in range(thread_slice[0], across.shape[0], thread_slice[1]):
        shadow[n] = -np.inf
        place[n] = start[n]
        ahead = 0.25 * surface.finest
        # Beyond, no terrain is high enough.
        while start[n] + ahead < reach and (surface.top - (start[n] + ahead) * slope > shadow[n]):
            s = start[n] + ahead
            x = s * towards[0] - across[n] * towards[1]
            y = s * towards[1] + across[n] * towards[0]
            z = _height(x, y, surface)
            if radius > 0.0:
                arc = np.hypot(x, y) / radius
                half = np.sin(0.5 * arc)
                s *= (1.0 + z / radius) * (np.sin(arc) / arc if arc > 0.0 else 1.0)
                # (R + z) cos(arc) - R without the difference of two radii.
                z -= 2.0 * (radius + z) * half * half
            if z - s * slope > shadow[n]:
                shadow[n] = z - s * slope
                place[n] = s
            ahead += max(0.25 * surface.finest, STEP_RATIO * ahead)
