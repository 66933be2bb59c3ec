"""Plain terrain queries: every rock, every triangle, no acceleration."""

from __future__ import annotations

import math

import numpy as np

from lunarsim.rocks.shapes import shape_table
from lunarsim.world.terrain import Terrain


def elevation(terrain: Terrain, x: float, y: float) -> float:
    """The higher of the triangulated relief and every rock over (x, y)."""
    g, z = terrain.relief.grid, terrain.relief.z.astype(float)
    u, v = (x - g.x0) / g.posting, (y - g.y0) / g.posting
    if not (0 <= u <= g.cols - 1 and 0 <= v <= g.rows - 1):
        return math.nan
    j, i = min(int(u), g.cols - 2), min(int(v), g.rows - 2)
    a = np.array([j, i, z[i, j]])
    c = np.array([j + 1, i + 1, z[i + 1, j + 1]])
    b = np.array([j + 1, i, z[i, j + 1]]) if u - j >= v - i else np.array([j, i + 1, z[i + 1, j]])
    n = np.cross(b - a, c - a)
    height = a[2] - (n[0] * (u - a[0]) + n[1] * (v - a[1])) / n[2]
    r = terrain.rocks
    for k in range(len(r)):
        dx, dy = x - r.x[k], y - r.y[k]
        e = (math.cos(r.yaw[k]) * dx + math.sin(r.yaw[k]) * dy) / r.a[k]
        f = (math.cos(r.yaw[k]) * dy - math.sin(r.yaw[k]) * dx) / r.b[k]
        height = max(height, r.base[k] + r.height[k] * unit_height(int(r.shape[k]), e, f))
    return height


def unit_height(shape: int, e: float, f: float) -> float:
    """Height of a unit shape over (e, f), -inf outside its outline."""
    table = shape_table()
    if table.count[shape] == 0:
        return math.sqrt(1.0 - e * e - f * f) if e * e + f * f < 1.0 else -math.inf
    top = math.inf
    for ne, nf, ng, d in table.planes[shape, : table.count[shape]]:
        if ng > 0.0:
            top = min(top, (d - ne * e - nf * f) / ng)
        elif ne * e + nf * f > d:
            return -math.inf
    return top


def march(terrain: Terrain, origin: np.ndarray, direction: np.ndarray, reach: float) -> float:
    """Range at which a ray falls below the surface, by small steps and bisection."""
    steps = np.arange(0.0, reach, 0.004)
    points = origin + steps[:, None] * direction
    above = points[:, 2] - terrain.elevation(points[:, :2])
    # The ray starts over unknown ground or above the surface and must come down from above.
    known = np.isfinite(above)
    below = np.flatnonzero(known & (above <= 0.0))
    if below.size == 0:
        return math.nan
    first = below[0]
    if first == 0 or not known[first - 1]:
        return math.nan
    low, high = steps[first - 1], steps[first]
    for _ in range(60):
        middle = 0.5 * (low + high)
        p = origin + middle * direction
        if p[2] - elevation(terrain, p[0], p[1]) > 0.0:
            low = middle
        else:
            high = middle
    return high
