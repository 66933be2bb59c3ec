# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled interpolation of tables over two directions."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def _interval(grid, value):
    """Return the index of the interval of an ascending grid that contains a value.

    For values outside the grid, it is the first or the last interval.
    """
    low, high = 0, grid.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if value >= grid[middle]:
            low = middle
        else:
            high = middle
    return low


@kernel()
def interpolate_table(table, x_nodes, y_nodes, x, y):
    """Interpolate the columns of a two-dimensional table bilinearly.

    `table` (rows, cols, columns) has values at ascending `x_nodes` (rows,) and `y_nodes` (cols,).
    The result (columns, n) is for points `x`, `y` (n,) within the nodes; NaN gives NaN.
    """
    columns = table.shape[2]
    out = np.empty((columns, x.size))
    for k in range(x.size):
        if not (x[k] == x[k] and y[k] == y[k]):
            for m in range(columns):
                out[m, k] = np.nan
            continue
        i, j = _interval(x_nodes, x[k]), _interval(y_nodes, y[k])
        u = (x[k] - x_nodes[i]) / (x_nodes[i + 1] - x_nodes[i])
        v = (y[k] - y_nodes[j]) / (y_nodes[j + 1] - y_nodes[j])
        a, b = (1.0 - u) * (1.0 - v), (1.0 - u) * v
        c, d = u * (1.0 - v), u * v
        for m in range(columns):
            value = table[i, j, m] * a + table[i, j + 1, m] * b
            value += table[i + 1, j, m] * c
            out[m, k] = value + table[i + 1, j + 1, m] * d
    return out
