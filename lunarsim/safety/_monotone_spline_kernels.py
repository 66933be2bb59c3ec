# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled bounds of sums of piecewise linear terms over many fits."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel(shared=True)
def extremes(share, base, values, knots, first, heights, low, high):
    """Write minimum and maximum over the fits of a sum of piecewise linear terms (n,).

    `share` is (first site, step between sites) of one thread.

    `base` (1 or n, fits) is the sum of each fit without the terms. Term t of `values` (terms, n)
    has the knots ``knots[first[t]:first[t + 1]]``, and its values at these knots are the same rows
    of `heights` (knots, fits); beyond them it is constant.
    """
    terms, n = values.shape
    fits = heights.shape[1]
    shared = base.shape[0] == 1
    for i in range(share[0], n, share[1]):
        total = np.empty(fits)
        start = np.int64(0) if shared else np.int64(i)
        for m in range(fits):
            total[m] = base[start, m]
        for t in range(terms):
            x = values[t, i]
            a = first[t]
            b = first[t + 1] - 1
            if x <= knots[a]:
                for m in range(fits):
                    total[m] += heights[a, m]
            elif x >= knots[b]:
                for m in range(fits):
                    total[m] += heights[b, m]
            else:
                while x >= knots[a + 1]:
                    a += 1
                share = (x - knots[a]) / (knots[a + 1] - knots[a])
                for m in range(fits):
                    total[m] += heights[a, m] + share * (heights[a + 1, m] - heights[a, m])
        minimum = total[0]
        maximum = total[0]
        for m in range(1, fits):
            minimum = min(minimum, total[m])
            maximum = max(maximum, total[m])
        low[i] = minimum
        high[i] = maximum
