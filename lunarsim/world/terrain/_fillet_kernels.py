# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled computation of the soil banked against rocks."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def raise_fillets(soil, x0, y0, p, x, y, a, b, cos, sin, height, reach):
    """Raise a grid of soil heights to the fillets (banked soil) around all rocks.

    `soil` (rows, cols), m, is changed in place where a fillet is higher; its first point is (x0,
    y0) and its spacing `p`, m. Rocks have centres x, y and half axes a, b, m (n,); `cos` and `sin`
    give the direction of axis a. `height` (n,) is the soil at each rock's outline, m, and `reach`
    the width of the fillets in rock radii.
    """
    rows, cols = soil.shape
    for n in range(x.size):
        far = (1.0 + reach) * max(a[n], b[n])
        i0 = max(int(np.ceil((y[n] - far - y0) / p)), 0)
        i1 = min(int(np.floor((y[n] + far - y0) / p)), rows - 1)
        j0 = max(int(np.ceil((x[n] - far - x0) / p)), 0)
        j1 = min(int(np.floor((x[n] + far - x0) / p)), cols - 1)
        for i in range(i0, i1 + 1):
            dy = y0 + i * p - y[n]
            for j in range(j0, j1 + 1):
                dx = x0 + j * p - x[n]
                u = (dx * cos[n] + dy * sin[n]) / a[n]
                v = (dy * cos[n] - dx * sin[n]) / b[n]
                left = 1.0 - max(np.sqrt(u * u + v * v) - 1.0, 0.0) / reach
                if left > 0.0:
                    soil[i, j] = max(soil[i, j], height[n] * left * left)
