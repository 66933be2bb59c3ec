# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled ordinary kriging of heights, and counting of posts below a scan."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.onboard.navigation._nearest_kernels import nearest, sort_by_square


@kernel(allocates=False)
def _solve(a, b):
    """Solve a x = b by Gaussian elimination with pivoting; x overwrites b (n,)."""
    n = b.size
    for c in range(n):
        best = c
        for r in range(c + 1, n):
            if abs(a[r, c]) > abs(a[best, c]):
                best = r
        if best != c:
            b[c], b[best] = b[best], b[c]
            for j in range(c, n):
                a[c, j], a[best, j] = a[best, j], a[c, j]
        for r in range(c + 1, n):
            share = a[r, c] / a[c, c]
            b[r] -= share * b[c]
            for j in range(c + 1, n):
                a[r, j] -= share * a[c, j]
    for c in range(n - 1, -1, -1):
        for j in range(c + 1, n):
            b[c] -= a[c, j] * b[j]
        b[c] /= a[c, c]


@kernel()
def _height_at(east, north, squares, known, x, y, count, growth, own):
    """Return the interpolated height at one point; see `interpolate_heights`."""
    chosen = np.empty(count, np.int64)
    away = np.empty(count)
    system = np.empty((count + 1, count + 1))
    weights = np.empty(count + 1)
    nearest(east, north, x, y, squares, chosen, away)
    for i in range(count):
        for j in range(count):
            dx = east[chosen[i]] - east[chosen[j]]
            dy = north[chosen[i]] - north[chosen[j]]
            system[i, j] = 0.5 * growth * np.sqrt(dx * dx + dy * dy) + own * own
        system[i, i] = 0.0
        system[i, count] = system[count, i] = 1.0
        weights[i] = 0.5 * growth * np.sqrt(away[i]) + own * own
    system[count, count] = 0.0
    weights[count] = 1.0
    _solve(system, weights)
    total = 0.0
    for i in range(count):
        total += weights[i] * known[chosen[i]]
    return total


@kernel(parallel=True)
def interpolate_heights(places, known, at, count, growth, own):
    """Interpolate heights (b,) at points (b, 2) from known heights at places, m.

    Parameters
    ----------
    places, known, at
        Places (n, 2), their heights (n,), and points (b, 2); n must be at least `count`.
    count
        Number of neighbours.
    growth, own
        Growth of the variance of a height difference with distance, m^2/m, and standard deviation
        of a single height at zero distance, m.
    """
    out = np.empty(len(at))
    east, north = places[:, 0].copy(), places[:, 1].copy()
    squares = sort_by_square(east, north)
    for b in prange(len(at)):
        x, y = at[b, 0], at[b, 1]
        if np.isfinite(x) and np.isfinite(y):
            out[b] = _height_at(east, north, squares, known, x, y, count, growth, own)
        else:
            out[b] = np.nan
    return out


@kernel()
def _crossing(
    at, east, north, squares, known, origin, per_drop, height, search, count, growth, own
):
    """Write the intersection of one line with the terrain (3,); see `intersect_lines`."""
    passes, found, least, most = search
    last_height, last_gap, nearest_yet = height, np.nan, np.inf
    for _ in range(passes):
        x, y = (
            origin[0] + per_drop[0] * (origin[2] - height),
            origin[1] + per_drop[1] * (origin[2] - height),
        )
        here = np.nan
        if np.isfinite(x) and np.isfinite(y):
            here = _height_at(east, north, squares, known, x, y, count, growth, own)
        gap = here - height
        # Without convergence, the best iterate counts; NaN: the terrain height is unknown.
        if not abs(gap) >= nearest_yet:
            at[0], at[1], at[2] = x, y, here
            nearest_yet = abs(gap)
        if not abs(gap) > found:
            return
        # Secant step: intersect the line with the terrain slope between the last two iterates.
        slope = (last_gap - gap) / (height - last_height)
        if slope < least:
            slope = least
        elif slope > most:
            slope = most
        step = gap / slope
        last_height, last_gap, height = height, gap, height + step if np.isfinite(step) else here


@kernel(parallel=True)
def intersect_lines(places, known, origin, per_drop, height, search, count, growth, own):
    """Intersect lines from a point (3,) with the interpolated terrain (b, 3), m.

    The terrain is that of `interpolate_heights`. The iteration equals that of `RockFilter`.
    Parameters are those of `wandering_ground.intersect_lines`; `count` and `own` as for
    `interpolate_heights`.
    """
    out = np.empty((len(per_drop), 3))
    east, north = places[:, 0].copy(), places[:, 1].copy()
    squares = sort_by_square(east, north)
    for b in prange(len(per_drop)):
        _crossing(
            out[b], east, north, squares, known, origin, per_drop[b], height[b], search, count,
            growth, own,
        )  # fmt: skip
    return out


@kernel()
def squares_under(points, side, most):
    """Count the squares that contain points (n, 3), up to `most`.

    NaN marks missing points. The squares start at the minimum east and north. The result is -1 if
    the grid of squares would be too large, as for a scan that grazes the terrain.
    """
    west, east, south, north = np.inf, -np.inf, np.inf, -np.inf
    for i in range(len(points)):
        if np.isfinite(points[i, 0]) and np.isfinite(points[i, 1]):
            west, east = min(west, points[i, 0]), max(east, points[i, 0])
            south, north = min(south, points[i, 1]), max(north, points[i, 1])
    if not west <= east:
        return 0
    wide = np.floor((east - west) / side) + 1.0
    high = np.floor((north - south) / side) + 1.0
    if not wide * high < 4e6:
        return -1
    cols = int(wide)
    seen = np.zeros(cols * int(high), np.bool_)
    count = 0
    for i in range(len(points)):
        if np.isfinite(points[i, 0]) and np.isfinite(points[i, 1]):
            col = int(np.floor((points[i, 0] - west) / side))
            place = int(np.floor((points[i, 1] - south) / side)) * cols + col
            if not seen[place]:
                seen[place] = True
                count += 1
                if count == most:
                    return count
    return count
