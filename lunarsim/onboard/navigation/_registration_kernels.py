# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled comparison of scanned tiles with a map, and registration of scans."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel(finite=True)
def tile_log_likelihoods(
    map_height,
    map_negative_log_density,
    map_known,
    tile_height,
    tile_weight,
    half_inverse_variance,
    peak_log_density,
    min_ratio,
    row,
    col,
):
    """Return the log-likelihood ratio of a scanned tile at each of n places on a map.

    The ratio compares the map heights below the tile, given the tile, with their density over the
    entire map; positive where the tile fits. `map_height`, `map_negative_log_density` and
    `map_known` (rows, cols) are heights above the local planes, m, the negative logarithm of their
    density over the map, and 1 where known, else 0. `tile_height`, `tile_weight`,
    `half_inverse_variance` and `peak_log_density` (r, c) describe the tile: heights above the
    local planes, m; 1 where known, else 0; 1 / (2 variance) of the height residual, 1/m^2;
    logarithm of the residual's density at 0. Densities are in 1/m. `min_ratio` is the minimum
    log-likelihood ratio of a grid point. `row` and `col` (n,) locate the map grid point below the
    tile's first grid point; they can lie off the map. The results are the sum of the ratios over
    the grid points known in tile and map (n,), and the number of these grid points (n,).
    """
    n = row.size
    rows, cols = map_height.shape
    high, wide = tile_height.shape
    ratio = np.zeros(n)
    covered = np.zeros(n)
    for i in range(n):
        first, last = max(0, -col[i]), min(wide, cols - col[i])
        total = np.float32(0.0)
        count = np.float32(0.0)
        for r in range(max(0, -row[i]), min(high, rows - row[i])):
            if last <= first:
                break
            shared = slice(col[i] + first, col[i] + last)
            # Row views with non-negative indices let the compiler vectorise the loop.
            s, b, k = (
                map_height[row[i] + r, shared],
                map_negative_log_density[row[i] + r, shared],
                map_known[row[i] + r, shared],
            )
            h, w = tile_height[r, first:last], tile_weight[r, first:last]
            q, p = half_inverse_variance[r, first:last], peak_log_density[r, first:last]
            for c in range(last - first):
                d = s[c] - h[c]
                is_compared = w[c] * k[c]
                total += is_compared * max(b[c] + p[c] - d * d * q[c], min_ratio)
                count += is_compared
        ratio[i] = total
        covered[i] = count
    return ratio, covered


# Maximum index of a square from the grid's origin; the product of two must fit into 64 bits.
_FARTHEST = float(1 << 30)


@kernel(inner=True)
def _no_squares():
    none = np.empty(0, np.int64)
    return none, none, np.empty((0, 3)), none


@kernel()
def average_points(points, x0, y0, posting, min_count):
    """Average scan points (n, 3), m, over the squares of a grid.

    The square (0, 0) is centred at `x0`, `y0`, and squares have the side `posting`, m. NaN points,
    and squares with fewer than `min_count` points, are omitted. The results are the column (m,),
    row (m,), mean point (m, 3) and number of points (m,) of each of the m squares, row by row;
    columns and rows can be negative or outside the map. All results are empty if the points span
    more than 4 million squares or lie too far from the square (0, 0).
    """
    n = points.shape[0]
    col = np.empty(n, np.int64)
    row = np.empty(n, np.int64)
    west, east, south, north = 1 << 40, -(1 << 40), 1 << 40, -(1 << 40)
    for i in range(n):
        if not (
            np.isfinite(points[i, 0]) and np.isfinite(points[i, 1]) and np.isfinite(points[i, 2])
        ):
            row[i] = -(1 << 40)
            continue
        x, y = (points[i, 0] - x0) / posting + 0.5, (points[i, 1] - y0) / posting + 0.5
        if max(abs(x), abs(y)) > _FARTHEST:
            return _no_squares()
        col[i], row[i] = np.int64(np.floor(x)), np.int64(np.floor(y))
        west, east = min(west, col[i]), max(east, col[i])
        south, north = min(south, row[i]), max(north, row[i])
    wide = east - west + 1
    high = north - south + 1
    # A scan that grazes the horizon covers an unlimited area and cannot be compared.
    if east < west or wide * high > 4_000_000:
        return _no_squares()
    sums = np.zeros((high * wide, 3))
    count = np.zeros(high * wide, np.int64)
    for i in range(n):
        if row[i] == -(1 << 40):
            continue
        s = (row[i] - south) * wide + col[i] - west
        count[s] += 1
        for k in range(3):
            sums[s, k] += points[i, k]
    m = 0
    for s in range(count.size):
        if count[s] >= min_count:
            m += 1
    out_col = np.empty(m, np.int64)
    out_row = np.empty(m, np.int64)
    mean = np.empty((m, 3))
    number = np.empty(m, np.int64)
    m = 0
    for s in range(count.size):
        if count[s] >= min_count:
            out_col[m] = west + s % wide
            out_row[m] = south + s // wide
            number[m] = count[s]
            for k in range(3):
                mean[m, k] = sums[s, k] / count[s]
            m += 1
    return out_col, out_row, mean, number


@kernel()
def centre_heights(col, row, mean, x0, y0, posting, centre_tolerance):
    """Extrapolate mean heights to the square centres along slopes between neighbours.

    `col`, `row` (n,) and `mean` (n, 3) are the result of `average_points`, for a grid with origin
    `x0`, `y0` and squares with the side `posting`, m. The results are height (n,), m, and slope
    (n, 2), east and north, at the centres, and `good` (n,): whether the square has neighbours on
    all four sides and its mean point lies within `centre_tolerance`, m, of the centre along each
    axis. Height and slope have no meaning where `good` is False.
    """
    m = col.size
    height = np.empty(m)
    slope = np.zeros((m, 2))
    good = np.zeros(m, np.bool_)
    if m == 0:
        return height, slope, good
    west, south = col.min(), row.min()
    wide, high = col.max() - west + 1, row.max() - south + 1
    place = np.full(wide * high, -1, np.int64)
    for i in range(m):
        place[(row[i] - south) * wide + col[i] - west] = i
    for i in range(m):
        c, r = col[i] - west, row[i] - south
        x, y = x0 + posting * col[i], y0 + posting * row[i]
        if (
            abs(mean[i, 0] - x) > centre_tolerance
            or abs(mean[i, 1] - y) > centre_tolerance
            or c == 0
            or r == 0
            or c == wide - 1
            or r == high - 1
        ):
            continue
        left, right = place[r * wide + c - 1], place[r * wide + c + 1]
        below, above = place[(r - 1) * wide + c], place[(r + 1) * wide + c]
        if left < 0 or right < 0 or below < 0 or above < 0:
            continue
        slope[i, 0] = (mean[right, 2] - mean[left, 2]) / (mean[right, 0] - mean[left, 0])
        slope[i, 1] = (mean[above, 2] - mean[below, 2]) / (mean[above, 1] - mean[below, 1])
        height[i] = mean[i, 2] + slope[i, 0] * (x - mean[i, 0]) + slope[i, 1] * (y - mean[i, 1])
        good[i] = True
    return height, slope, good


@kernel()
def scan_jacobian(points, vectors, position, body_rotation, sensor_rotation, velocity, rate):
    """Return the Jacobian (n, 11) of scan points by scan errors, along given vectors.

    The errors are position, small rotation (body axes), range, boresight (sensor axes) and latency.
    Row i is the displacement of `points` i by each error, projected on `vectors` i; both are (n,
    3). `position` (3,), m, and `velocity` (3,), m/s, are those of the lander in the frame of the
    points; `body_rotation` and `sensor_rotation` (3, 3) turn body and sensor axes into that frame;
    `rate` (3,) is the body rate, rad/s.
    """
    out = np.empty((len(points), 11))
    away, turn = np.empty(3), np.empty(3)
    for i in range(len(points)):
        reach = along = late = 0.0
        for k in range(3):
            away[k] = points[i, k] - position[k]
            reach += away[k] * away[k]
            along += away[k] * vectors[i, k]
            late += velocity[k] * vectors[i, k]
            out[i, k] = vectors[i, k]
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            turn[k] = away[a] * vectors[i, b] - away[b] * vectors[i, a]
        for k in range(3):
            body = sensor = 0.0
            for j in range(3):
                body += turn[j] * body_rotation[j, k]
                sensor += turn[j] * sensor_rotation[j, k]
            out[i, 3 + k], out[i, 7 + k] = body, sensor
            late += body * rate[k]
        out[i, 6] = along / max(np.sqrt(reach), 1e-9)
        out[i, 10] = -late
    return out
