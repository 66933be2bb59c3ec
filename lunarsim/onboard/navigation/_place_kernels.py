# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled comparison of a scanned tile with a map at many places."""

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

    `map_height`, `map_negative_log_density` and `map_known` (rows, cols) are heights above the
    local planes, m, the negative logarithm of their density over the map, and 1 where known, else
    0. `tile_height`, `tile_weight`, `half_inverse_variance` and `peak_log_density` (r, c) describe
    the tile: heights above the local planes, m; 1 where known, else 0; 1 / (2 variance) of the
    height residual, 1/m^2; logarithm of the residual's density at 0. Densities are in 1/m.
    `min_ratio` is the minimum log-likelihood ratio of a grid point. `row` and `col` (n,) locate the
    map grid point below the tile's first grid point; they can lie off the map. The results are the
    sum of the ratios over the grid points (n,), and the number of compared grid points (n,).
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
