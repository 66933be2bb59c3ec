"""Plain terrain queries: every rock, every triangle, no acceleration.

The unit shapes of rocks are their vertices (shapes, n, 3), padded with NaN.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations

import numpy as np


def elevations(terrain, points: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """The higher of the triangulated relief and every rock at points (n, 2), NaN off the map."""
    g, z = terrain.relief.grid, terrain.relief.z.astype(float)
    u, v = (points[:, 0] - g.x0) / g.posting, (points[:, 1] - g.y0) / g.posting
    inside = (u >= 0) & (u <= g.cols - 1) & (v >= 0) & (v <= g.rows - 1)
    u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    j, i = np.minimum(u.astype(int), g.cols - 2), np.minimum(v.astype(int), g.rows - 2)
    s, t = u - j, v - i
    a, c = z[i, j], z[i + 1, j + 1]
    # Each triangle has a side along x and one along y.
    lower = a + s * (z[i, j + 1] - a) + t * (c - z[i, j + 1])
    upper = a + t * (z[i + 1, j] - a) + s * (c - z[i + 1, j])
    height = np.where(s >= t, lower, upper)
    r = terrain.rocks
    for k in range(len(r)):
        x, y = points.T
        near = (np.abs(x - r.x[k]) < 3.0 * r.a[k]) & (np.abs(y - r.y[k]) < 3.0 * r.a[k])
        height[near] = np.maximum(height[near], rock_top(r, k, x[near], y[near], shapes))
    return np.where(inside, height, math.nan)


def rock_top(r, k: int, x: np.ndarray, y: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Top of rock k over (x, y), -inf beside it."""
    dx, dy = x - r.x[k], y - r.y[k]
    e = (math.cos(r.yaw[k]) * dx + math.sin(r.yaw[k]) * dy) / r.a[k]
    f = (math.cos(r.yaw[k]) * dy - math.sin(r.yaw[k]) * dx) / r.b[k]
    return r.base[k] + r.height[k] * unit_height(shapes[r.shape[k]], e, f)


@cache
def _upper_facets(vertices: tuple) -> list[np.ndarray]:
    """Return the triangles (3, 3) of vertices that no other vertex lies above."""
    points = np.array(vertices)
    facets = []
    for triple in combinations(range(len(points)), 3):
        a, b, c = points[list(triple)]
        normal = np.cross(b - a, c - a)
        upward = normal * np.sign(normal[2])
        if abs(normal[2]) > 1e-12 and ((points - a) @ upward <= 1e-9).all():
            facets.append(np.array([a, b, c]))
    return facets


def unit_height(vertices: np.ndarray, e: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Height of a unit shape over (e, f), -inf outside its outline; a hemisphere has no vertices.

    The upper hull of the vertices is found by trying all triangles.
    """
    known = vertices[np.isfinite(vertices).all(axis=1)]
    if not len(known):
        square = 1.0 - e * e - f * f
        return np.where(square > 0.0, np.sqrt(np.maximum(square, 0.0)), -math.inf)
    top = np.full(np.shape(e), -math.inf)
    for corners in _upper_facets(tuple(map(tuple, known.tolist()))):
        # Shares of the corners: their sum is 1, and their weighted mean is (e, f).
        system = np.vstack((corners[:, :2].T, np.ones(3)))
        shares = np.linalg.solve(system, np.stack((e, f, np.ones(np.shape(e)))))
        inside = (shares >= -1e-12).all(axis=0)
        top = np.where(inside, np.maximum(top, corners[:, 2] @ shares), top)
    return top


def march(terrain, origins: np.ndarray, directions: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Ranges at which rays (n, 3) fall below the surface, by small steps and bisection."""
    bounds = [
        _first_step_below(terrain, o, d, shapes) for o, d in zip(origins, directions, strict=True)
    ]
    low, high = np.array(bounds).T
    for _ in range(60):
        middle = 0.5 * (low + high)
        p = origins + middle[:, None] * directions
        above = p[:, 2] - elevations(terrain, p[:, :2], shapes) > 0.0
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return high


def _first_step_below(
    terrain, origin: np.ndarray, direction: np.ndarray, shapes: np.ndarray
) -> tuple[float, float]:
    """Ranges of the last step above the surface and the first below it, NaN where none is."""
    tops = terrain.rocks.base + terrain.rocks.height
    z = terrain.relief.z
    highest = max(float(np.nanmax(z)), *map(float, tops)) + 0.01
    lowest = min(float(np.nanmin(z)), *map(float, terrain.rocks.base)) - 0.01
    # Above all ground there is nothing to meet, nor below it.
    begin = max((highest - origin[2]) / direction[2], 0.0)
    steps = np.arange(begin, (lowest - origin[2]) / direction[2] + 0.004, 0.004)
    points = origin + steps[:, None] * direction
    above = points[:, 2] - elevations(terrain, points[:, :2], shapes)
    # The ray starts over unknown ground or above the surface and must come down from above.
    known = np.isfinite(above)
    below = np.flatnonzero(known & (above <= 0.0))
    if below.size == 0 or below[0] == 0 or not known[below[0] - 1]:
        return math.nan, math.nan
    return steps[below[0] - 1], steps[below[0]]


def soil_about(rocks, share, ground, reach, point):
    """Height of the soil banked against rocks at one point, rock by rock."""
    most = 0.0
    for k in range(len(rocks)):
        over = share * max(float(rocks.base[k] + rocks.height[k] - ground[k]), 0.0)
        east, north = point[0] - rocks.x[k], point[1] - rocks.y[k]
        turned = complex(east, north) * np.exp(-1j * rocks.yaw[k])
        away = abs(complex(turned.real / rocks.a[k], turned.imag / rocks.b[k]))
        if away <= 1.0:
            most = max(most, over)
        elif away < 1.0 + reach:
            most = max(most, over * ((1.0 + reach - away) / reach) ** 2)
    return most
