# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled comparison of a scanned tile with a map at many places."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel(finite=True)
def evidence(shown, negative_log_density, known, height, weight, sharpness, level, floor, row, col):
    """Return the log-likelihood ratios of a scanned tile at places on a map.

    Parameters
    ----------
    shown, negative_log_density, known
        Map (rows, cols): heights above the local planes, m; negative logarithm of the density of
        such heights, density in 1/m; 1 where known, else 0.
    height, weight, sharpness, level
        Tile (r, c): heights above the local planes, m; 1 where known, else 0; inverse of twice the
        variance of a residual, 1/m^2; logarithm of the residual's density at 0, density in 1/m.
    floor
        Minimum log-likelihood ratio of a grid point.
    row, col
        Row and column of the map grid point below the first grid point of the tile (n,); can be off
        the map.

    Returns
    -------
    ratio, covered
        Sum of the log-likelihood ratios of the grid points, and number of compared grid points
        (n,).
    """
    n = row.size
    rows, cols = shown.shape
    high, wide = height.shape
    ratio = np.zeros(n)
    covered = np.zeros(n)
    for i in range(n):
        first, last = max(0, -col[i]), min(wide, cols - col[i])
        total = np.float32(0.0)
        count = np.float32(0.0)
        for r in range(max(0, -row[i]), min(high, rows - row[i])):
            if last <= first:
                break
            here = slice(col[i] + first, col[i] + last)
            # Row views with non-negative indices let the compiler vectorise the loop.
            s, b, k = (
                shown[row[i] + r, here],
                negative_log_density[row[i] + r, here],
                known[row[i] + r, here],
            )
            h, w = height[r, first:last], weight[r, first:last]
            q, p = sharpness[r, first:last], level[r, first:last]
            for c in range(last - first):
                d = s[c] - h[c]
                both = w[c] * k[c]
                total += both * max(b[c] + p[c] - d * d * q[c], floor)
                count += both
        ratio[i] = total
        covered[i] = count
    return ratio, covered
