# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for the highest sample near rocks."""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel


@kernel()
def highest_residual(residual_heights, x0, y0, posting, xy, reach):
    """Return the maximum residual height near points (n,); 0 without a sample.

    `residual_heights` (rows, cols) holds the residual height of the sample of each cell, NaN
    without one.
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
