# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled ordinary kriging of heights, and counting of grid squares below a scan."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.onboard.navigation._nearest_kernels import find_nearest, sort_by_square


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
def _height_at(east, north, squares, known_height, x, y, count, variance_growth, nugget_sigma):
    """Return the terrain height at one point (x, y), m, by ordinary kriging.

    `east`, `north` (n,), m, are the points with known heights `known_height` (n,), m; `squares` is
    their order from `sort_by_square`. The other parameters are those of `interpolate_heights`.
    """
    neighbours = np.empty(count, np.int64)
    squared_distances = np.empty(count)
    system = np.empty((count + 1, count + 1))
    weights = np.empty(count + 1)
    find_nearest(east, north, x, y, squares, neighbours, squared_distances)
    for i in range(count):
        for j in range(count):
            dx = east[neighbours[i]] - east[neighbours[j]]
            dy = north[neighbours[i]] - north[neighbours[j]]
            system[i, j] = (
                0.5 * variance_growth * np.sqrt(dx * dx + dy * dy) + nugget_sigma * nugget_sigma
            )
        system[i, i] = 0.0
        system[i, count] = system[count, i] = 1.0
        weights[i] = (
            0.5 * variance_growth * np.sqrt(squared_distances[i]) + nugget_sigma * nugget_sigma
        )
    system[count, count] = 0.0
    weights[count] = 1.0
    _solve(system, weights)
    total = 0.0
    for i in range(count):
        total += weights[i] * known_height[neighbours[i]]
    return total


@kernel(parallel=True)
def interpolate_heights(known_xy, known_height, query_xy, count, variance_growth, nugget_sigma):
    """Interpolate terrain heights (b,), m, at points `query_xy` by ordinary kriging.

    The points are (b, 2), m. Heights `known_height` (n,), m, are known at `known_xy` (n, 2), m;
    each result is a weighted mean of the `count` nearest ones (n >= `count`). `variance_growth` is
    the growth of the variance of a height difference with distance, m^2/m. `nugget_sigma` is the
    standard deviation of a height from the terrain around it (nugget), m.
    """
    out = np.empty(len(query_xy))
    east, north = known_xy[:, 0].copy(), known_xy[:, 1].copy()
    squares = sort_by_square(east, north)
    for b in prange(len(query_xy)):
        x, y = query_xy[b, 0], query_xy[b, 1]
        if np.isfinite(x) and np.isfinite(y):
            out[b] = _height_at(
                east, north, squares, known_height, x, y, count, variance_growth, nugget_sigma
            )
        else:
            out[b] = np.nan
    return out


@kernel()
def _intersect_line(
    out,
    east,
    north,
    squares,
    known_height,
    origin,
    per_drop,
    start_height,
    iteration_limits,
    count,
    variance_growth,
    nugget_sigma,
):
    """Write the intersection of one line of sight with the terrain to `out` (3,), m.

    `east`, `north`, `squares` and `known_height` are those of `_height_at`; the other parameters
    are those of `intersect_lines`, for one line.
    """
    passes, tolerance, min_slope, max_slope = iteration_limits
    last_height, last_gap, nearest_yet = start_height, np.nan, np.inf
    for _ in range(passes):
        x, y = (
            origin[0] + per_drop[0] * (origin[2] - start_height),
            origin[1] + per_drop[1] * (origin[2] - start_height),
        )
        terrain_height = np.nan
        if np.isfinite(x) and np.isfinite(y):
            terrain_height = _height_at(
                east, north, squares, known_height, x, y, count, variance_growth, nugget_sigma
            )
        gap = terrain_height - start_height
        # Without convergence, the best iterate counts; NaN: the terrain height is unknown.
        if not abs(gap) >= nearest_yet:
            out[0], out[1], out[2] = x, y, terrain_height
            nearest_yet = abs(gap)
        if not abs(gap) > tolerance:
            return
        # Secant step: intersect the line with the terrain slope between the last two iterates.
        slope = (last_gap - gap) / (start_height - last_height)
        if slope < min_slope:
            slope = min_slope
        elif slope > max_slope:
            slope = max_slope
        step = gap / slope
        last_height, last_gap, start_height = (
            start_height,
            gap,
            start_height + step if np.isfinite(step) else terrain_height,
        )


@kernel(parallel=True)
def intersect_lines(
    known_xy,
    known_height,
    origin,
    per_drop,
    start_height,
    iteration_limits,
    count,
    variance_growth,
    nugget_sigma,
):
    """Return the intersections (b, 3), m, of lines of sight with kriged terrain.

    The lines start at `origin` (3,), m, and advance by `per_drop` (b, 2), east and north, per metre
    of drop. A secant iteration starts from the heights `start_height` (b,), m. `iteration_limits`
    is the maximum number of iterations, the height tolerance (m), and the minimum and maximum
    factor of a step relative to the last height difference. The other parameters define the terrain
    as for `interpolate_heights`.
    """
    out = np.empty((len(per_drop), 3))
    east, north = known_xy[:, 0].copy(), known_xy[:, 1].copy()
    squares = sort_by_square(east, north)
    for b in prange(len(per_drop)):
        _intersect_line(
            out[b],
            east,
            north,
            squares,
            known_height,
            origin,
            per_drop[b],
            start_height[b],
            iteration_limits,
            count,
            variance_growth,
            nugget_sigma,
        )
    return out


@kernel()
def count_covered_squares(points, side, max_count):
    """Count the grid squares that contain at least one of the points (n, 3), m.

    Counting stops at `max_count`. Squares have the side `side`, m, and start at the minimum east
    and north. NaN marks missing points. The result is -1 if the grid of squares would be too large,
    as for a scan that grazes the terrain.
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
                if count == max_count:
                    return count
    return count
