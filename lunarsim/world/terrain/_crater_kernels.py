"""Compiled stamping of craters into a grid of posts."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange


@kernel(parallel=True)
def stamp(z, x0, y0, p, x, y, diameter, freshness, depth, rim_height, reach):
    """Add the profile of every crater to `z`, row by row; see `craters.crater_profile`."""
    rows, cols = z.shape
    for i in prange(rows):
        py = y0 + i * p
        for n in range(x.size):
            radius = 0.5 * diameter[n]
            dy = py - y[n]
            span = (reach * radius) ** 2 - dy * dy
            if span <= 0.0:
                continue
            half = np.sqrt(span)
            j0 = max(int(np.ceil((x[n] - half - x0) / p)), 0)
            j1 = min(int(np.floor((x[n] + half - x0) / p)), cols - 1)
            f = freshness[n]
            rim = rim_height * diameter[n] * f * f
            for j in range(j0, j1 + 1):
                dx = x0 + j * p - x[n]
                q = (dx * dx + dy * dy) / (radius * radius)
                if q < 1.0:
                    z[i, j] += rim + depth * diameter[n] * f * (q - 1.0)
                else:
                    s = np.sqrt(q)
                    fade = max((reach - s) / (reach - 1.0), 0.0)
                    z[i, j] += rim / (q * s) * fade * fade * (3.0 - 2.0 * fade)
