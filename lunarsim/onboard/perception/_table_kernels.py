# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled interpolation of tables over two directions."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def _interval(grid, value):
    """Return the index of the interval of an ascending grid that contains a value."""
    low, high = 0, grid.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if value >= grid[middle]:
            low = middle
        else:
            high = middle
    return low


@kernel()
def interpolated(table, x, y, at_x, at_y):
    """Interpolate the columns of a two-dimensional table bilinearly.

    Parameters
    ----------
    table
        Values at the nodes (rows, cols, columns).
    x, y
        Nodes (rows,), (cols,), ascending.
    at_x, at_y
        Points (n,), within the nodes; NaN gives NaN.

    Returns
    -------
    out
        Interpolated values (columns, n).
    """
    columns = table.shape[2]
    out = np.empty((columns, at_x.size))
    for k in range(at_x.size):
        if not (at_x[k] == at_x[k] and at_y[k] == at_y[k]):
            for m in range(columns):
                out[m, k] = np.nan
            continue
        i, j = _interval(x, at_x[k]), _interval(y, at_y[k])
        u = (at_x[k] - x[i]) / (x[i + 1] - x[i])
        v = (at_y[k] - y[j]) / (y[j + 1] - y[j])
        a, b = (1.0 - u) * (1.0 - v), (1.0 - u) * v
        c, d = u * (1.0 - v), u * v
        for m in range(columns):
            value = table[i, j, m] * a + table[i, j + 1, m] * b
            value += table[i + 1, j, m] * c
            out[m, k] = value + table[i + 1, j + 1, m] * d
    return out
