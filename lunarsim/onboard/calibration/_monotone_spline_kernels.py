# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled bounds of sums of piecewise linear terms over many fits."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel(shared=True)
def fit_extremes(thread_slice, base, values, knots, first_knot, contributions, low, high):
    """Write minimum and maximum over the fits of a sum of piecewise linear terms.

    `low` and `high` (n,) receive them for each of n sites. `base` (1 or n, fits) is the sum of
    each fit without the terms. Term t of `values` (terms, n) has the knots
    ``knots[first_knot[t]:first_knot[t + 1]]``; the same rows of `contributions` (knots, fits) are
    what it adds to each fit there. Beyond its knots a term is constant. `thread_slice` is (first
    site, step between sites) of one thread.
    """
    terms, n = values.shape
    fits = contributions.shape[1]
    shared = base.shape[0] == 1
    for i in range(thread_slice[0], n, thread_slice[1]):
        total = np.empty(fits)
        start = np.int64(0) if shared else np.int64(i)
        for m in range(fits):
            total[m] = base[start, m]
        for t in range(terms):
            x = values[t, i]
            a = first_knot[t]
            b = first_knot[t + 1] - 1
            if x <= knots[a]:
                for m in range(fits):
                    total[m] += contributions[a, m]
            elif x >= knots[b]:
                for m in range(fits):
                    total[m] += contributions[b, m]
            else:
                while x >= knots[a + 1]:
                    a += 1
                fraction = (x - knots[a]) / (knots[a + 1] - knots[a])
                for m in range(fits):
                    total[m] += contributions[a, m] + fraction * (
                        contributions[a + 1, m] - contributions[a, m]
                    )
        minimum = total[0]
        maximum = total[0]
        for m in range(1, fits):
            minimum = min(minimum, total[m])
            maximum = max(maximum, total[m])
        low[i] = minimum
        high[i] = maximum
