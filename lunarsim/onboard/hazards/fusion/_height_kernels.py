# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for the highest sample near rocks."""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel


@kernel()
def highest_residual(residual_heights, x0, y0, posting, xy, reach):
    """Return the maximum residual height near each of n positions (n,), m.

    The residual height of an elevation sample is its height above a plane fitted to the terrain.
    `residual_heights` (rows, cols) holds that of each cell, m, NaN without a sample. (`x0`, `y0`)
    is the centre of cell (0, 0) and `posting` the cell size, m. `xy` (n, 2) are the positions and
    `reach` (n,) the search radii, m. The result is 0 where there is no sample.
    """
    rows, cols = residual_heights.shape
    out = np.zeros(xy.shape[0])
    for n in range(xy.shape[0]):
        x = xy[n, 0]
        y = xy[n, 1]
        r = reach[n]
        top = -np.inf
        for row in range(
            max(math.ceil((y - r - y0) / posting), 0),
            min(math.floor((y + r - y0) / posting), rows - 1) + 1,
        ):
            for col in range(
                max(math.ceil((x - r - x0) / posting), 0),
                min(math.floor((x + r - x0) / posting), cols - 1) + 1,
            ):
                z = residual_heights[row, col]
                if z > top and math.hypot(x0 + col * posting - x, y0 + row * posting - y) <= r:
                    top = z
        if top > -np.inf:
            out[n] = top
    return out
