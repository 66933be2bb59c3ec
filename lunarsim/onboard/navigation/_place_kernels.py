"""Compiled comparison of a tile of scanned ground with a map at many places."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel(finite=True)
def evidence(shown, rarity, known, height, weight, sharpness, level, floor, row, col):
    """Compare a tile with a map at places: how much likelier it fits there than any ground would.

    Parameters
    ----------
    shown, rarity, known
        Map (rows, cols): heights above the planes around, m; logarithm of one over the density of
        such heights, in 1 / m; 1 where known, else 0.
    height, weight, sharpness, level
        Tile (r, c): heights above the planes around, m; 1 where known, else 0; half of one over the
        variance of a residual, 1 / m^2; logarithm of its density at 0, in 1 / m.
    floor
        Least log-likelihood ratio of a post.
    row, col
        Of the map's posts under the tile's first one (n,); may lie off the map.

    Returns
    -------
    ratio, covered
        Sum of the log-likelihood ratios of posts, and number of posts compared (n,).
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
            # Rows of their own: indices that cannot be negative let the loop be vectorised.
            s, b, k = shown[row[i] + r, here], rarity[row[i] + r, here], known[row[i] + r, here]
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
