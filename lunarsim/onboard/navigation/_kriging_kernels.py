# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled nearest-neighbour search and ordinary kriging of heights."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange

# Mean number of places per square, and number of places up to which there is only one square.
_PLACES_PER_SQUARE, _MAX_UNDIVIDED = 2.0, 48
# Maximum number of rows and of columns of the grid, and minimum extent to be divided, m.
_MAX_ROWS, _MIN_EXTENT_M = 256, 1e-6


@kernel(allocates=False)
def _insert(i, squared_distance, count, indices, squared_distances):
    """Insert point i into a sorted list of nearest points; return the list's length.

    `count` is the length before, and `squared_distance` that of point i. `indices` (k,) and
    `squared_distances` (k,) are the list, nearest first; if it is full, the farthest point is
    dropped. Of points at the same distance those with lower indices come first.
    """
    k = indices.size
    if count == k and not (
        squared_distance < squared_distances[k - 1]
        or (squared_distance == squared_distances[k - 1] and i < indices[k - 1])
    ):
        return count
    at = count if count < k else k - 1
    while at > 0 and (
        squared_distance < squared_distances[at - 1]
        or (squared_distance == squared_distances[at - 1] and i < indices[at - 1])
    ):
        squared_distances[at], indices[at] = squared_distances[at - 1], indices[at - 1]
        at -= 1
    squared_distances[at], indices[at] = squared_distance, i
    return min(count + 1, k)


@kernel()
def sort_by_square(east, north):
    """Sort points by the square of a grid that they lie in.

    The coordinates of the points are `east` and `north` (n,), m. The results are the indices of the
    points (n,), square by square, in their original order within each; the start of each square in
    this order, and the end (rows * cols + 1,); and the grid (5,): west and south edge and side of a
    square, m, rows and columns. There is only one square if there are few points, they lie on a
    line east or north, or one is not finite.
    """
    n = len(east)
    west, south = east.min(), north.min()
    wide, high = east.max() - west, north.max() - south
    grid = np.array([west, south, np.inf, 1.0, 1.0])
    if n > _MAX_UNDIVIDED and _MIN_EXTENT_M < wide < np.inf and _MIN_EXTENT_M < high < np.inf:
        side = max(np.sqrt(wide * high * _PLACES_PER_SQUARE / n), max(wide, high) / _MAX_ROWS)
        grid[2], grid[3], grid[4] = side, np.floor(high / side) + 1.0, np.floor(wide / side) + 1.0
    rows, cols = int(grid[3]), int(grid[4])
    first = np.zeros(rows * cols + 1, np.int64)
    square = np.zeros(n, np.int64)
    if rows * cols > 1:
        for i in range(n):
            row = min(int((north[i] - south) / grid[2]), rows - 1)
            square[i] = row * cols + min(int((east[i] - west) / grid[2]), cols - 1)
    for i in range(n):
        first[square[i] + 1] += 1
    for s in range(rows * cols):
        first[s + 1] += first[s]
    order = np.empty(n, np.int64)
    to = first[:-1].copy()
    for i in range(n):
        order[to[square[i]]] = i
        to[square[i]] += 1
    return order, first, grid


@kernel(allocates=False)
def _search_square(
    row, col, cols, east, north, x, y, order, first, count, indices, squared_distances
):
    """Insert the points of one grid square into the list of nearest points.

    The list is `indices` and `squared_distances` (k,), with `count` entries before; the return
    value is the number of entries after. The square is given by its `row` and `col` in a grid with
    `cols` columns; distances are from (`x`, `y`), m. `east`, `north` (n,), `order` and `first` are
    coordinates and results of `sort_by_square`.
    """
    square = row * cols + col
    for k in range(first[square], first[square + 1]):
        i = order[k]
        dx, dy = east[i] - x, north[i] - y
        count = _insert(i, dx * dx + dy * dy, count, indices, squared_distances)
    return count


@kernel(allocates=False)
def find_nearest(east, north, x, y, squares, indices, squared_distances):
    """Find the k points nearest to (x, y), nearest first, in a grid of squares.

    Their indices are written to `indices` (k,) and the squared distances to `squared_distances`
    (k,); the return value is their number. If there are fewer than k points, the remaining elements
    stay unchanged. Of points at the same distance those with lower indices come first. `squares` is
    the result of `sort_by_square` for the coordinates `east` and `north` (n,). Squares are searched
    in rings about (x, y); points in ring n are at least n - 1 sides away.
    """
    order, first, grid = squares
    side, rows, cols = grid[2], int(grid[3]), int(grid[4])
    row = col = count = 0
    if rows * cols > 1:
        col = int(min(max((x - grid[0]) / side, 0.0), cols - 1.0))
        row = int(min(max((y - grid[1]) / side, 0.0), rows - 1.0))
    for ring in range(max(rows, cols)):
        if count == indices.size and ring > 0:
            min_distance = (ring - 1) * side
            if squared_distances[count - 1] < min_distance * min_distance:
                break
        for i in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            edge = i == row - ring or i == row + ring
            step = 1 if edge else max(2 * ring, 1)
            for j in range(col - ring, col + ring + 1, step):
                if 0 <= j < cols:
                    count = _search_square(
                        i,
                        j,
                        cols,
                        east,
                        north,
                        x,
                        y,
                        order,
                        first,
                        count,
                        indices,
                        squared_distances,
                    )
    return count


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

    The height is a weighted mean of the `count` nearest known heights. `known_height` (n,), m, are
    those at `east`, `north` (n,), m, and `squares` is the result of `sort_by_square`.
    `variance_growth`, m^2/m, and `nugget_sigma`, m, are those of `interpolate_heights`.
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

    The points are (b, 2), m; a point that is not finite gives NaN. Heights `known_height` (n,), m,
    are known at `known_xy` (n, 2), m; each result is a weighted mean of the `count` nearest ones
    (n >= `count`). `variance_growth` is the growth of the variance of a height difference with
    distance, m^2/m. `nugget_sigma` is the standard deviation of a height from the terrain around
    it (nugget), m.
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

    The line starts at `origin` (3,), m, and advances by `per_drop` (2,), east and north, per metre
    of drop; a secant iteration starts at `start_height`, m. If it does not converge, the iterate
    closest to the terrain is written. If `per_drop` is not finite, the height is NaN.
    `iteration_limits` is that of `intersect_lines`, the other parameters those of `_height_at`.
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

    The lines start at `origin` (3,), m, and advance by `per_drop` (b, 2), east and north, per
    metre of drop. A secant iteration starts from the heights `start_height` (b,), m; without
    convergence, the iterate closest to the terrain is returned. A step is the gap between terrain
    and line, divided by the decrease of the gap per metre of height in the last step.
    `iteration_limits` is the maximum number of iterations, the gap (m) at which they stop, and the
    limits (minimum, maximum) of this decrease. The other parameters define the terrain as for
    `interpolate_heights`.
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
    and north of the points. A point with NaN as east or north is ignored. The result is -1 if the
    points span 4 million squares or more, as for a scan that grazes the terrain.
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
