# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled ordinary kriging of heights, and counting of grid squares below a scan."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.onboard.navigation._nearest_kernels import nearest, sort_by_square


@kernel(allocates=False)
def _solve(a, b):
    """Solve the linear system a x = b by Gaussian elimination; x overwrites b (n,).

    Rows are pivoted; `a` (n, n) is overwritten.
    """
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
    """Return the terrain height at one point (x, y), m, by ordinary kriging.

    `east`, `north` and `known` (n,) are the known points, m; `squares` is their order from
    `sort_by_square`. The other parameters are those of `interpolate_heights`.
    """
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
    """Interpolate terrain heights (b,), m, at points (b, 2), m, by ordinary kriging.

    Parameters
    ----------
    places, known, at
        Horizontal positions (n, 2) of known heights (n,), and points to interpolate at (b, 2), all
        m; n must be at least `count`.
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
    """Write the intersection of one line of sight with the terrain to `at` (3,), m.

    `east`, `north`, `squares` and `known` are those of `_height_at`; the other parameters are those
    of `intersect_lines`, for one line.
    """
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
    """Return the intersections (b, 3), m, of lines of sight with kriged terrain.

    The iteration equals that of `RockFilter`. `places`, `known`, `count`, `growth` and `own` define
    the terrain as for `interpolate_heights`. The lines start at `origin` (3,), m, and advance by
    `per_drop` (b, 2), east and north, per metre of drop; `height` (b,), m, are the initial heights.
    `search` is the maximum number of iterations, the height tolerance (m), and the minimum and
    maximum factor of a step relative to the last height difference.
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
    """Count the grid squares that contain points (n, 3), m, up to `most`.

    Squares have the side `side`, m, and start at the minimum east and north. NaN marks missing
    points. The result is -1 if the grid of squares would be too large, as for a scan that grazes
    the terrain.
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
