# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled accumulation of moments for least-squares planes."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def plane_sums(points, x0, y0, side, out):
    """Accumulate the moments 1, x, y, z, xx, xy, yy, xz, yz of points per square.

    `points` (n, 3) are east, north, up, m. (`x0`, `y0`) is the south-west corner of the raster of
    squares and `side` the side of a square, m. The sums are added to `out` (rows, cols, 9), which
    has one entry per square; points off the raster are skipped. x and y are measured from the
    centre of the raster.
    """
    rows, cols = out.shape[:2]
    for n in range(points.shape[0]):
        j = int(np.floor((points[n, 0] - x0) / side))
        i = int(np.floor((points[n, 1] - y0) / side))
        if i < 0 or i >= rows or j < 0 or j >= cols:
            continue
        x = points[n, 0] - x0 - 0.5 * side * cols
        y = points[n, 1] - y0 - 0.5 * side * rows
        z = points[n, 2]
        s = out[i, j]
        s[0] += 1.0
        s[1] += x
        s[2] += y
        s[3] += z
        s[4] += x * x
        s[5] += x * y
        s[6] += y * y
        s[7] += x * z
        s[8] += y * z
