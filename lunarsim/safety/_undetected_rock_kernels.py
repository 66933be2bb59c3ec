# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled means of ratios over the rocks of a size distribution."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel(shared=True)
def mean_ratios(
    share, height, falling, min_diameter, numbers, shortest, ratio, first, step, law, out
):
    """Write the mean fraction of undetected rocks above a height at each site.

    The mean is over the rocks of the size distribution.

    Parameters
    ----------
    share
        First site and step between sites of one thread.
    height
        Height for all sites (1,) or for each site (sites,), m; at least `shortest`; NaN gives NaN.
    falling
        Remaining over previous rocks of each size class (classes + 1, sites), starting with those
        of rocks smaller than all classes.
    min_diameter, numbers
        Minimum diameter of each class (classes,), m, and the number of rocks above it.
    shortest, ratio
        Minimum height, m, and height over diameter of rocks.
    first, step, law
        Logarithms of the numbers of rocks (n,) at diameters whose logarithms start at `first` and
        are `step` apart.
    out
        Mean ratios (sites,).
    """
    last = law.size - 2
    for site in range(share[0], out.size, share[1]):
        above = height[site if height.size > 1 else 0]
        if np.isnan(above):
            out[site] = np.nan
            continue
        d = max(above, shortest) / ratio
        at = min(max((np.log(d) - first) / step, 0.0), last + 1.0)
        k = min(int(at), last)
        number = np.exp(law[k] + (at - k) * (law[k + 1] - law[k]))
        mean = falling[0, site]
        for n in range(min_diameter.size):
            # Fraction of the rocks above the height in this class or a larger one.
            larger = numbers[n] if d < min_diameter[n] else number
            if number > 0.0:
                mean += (falling[n + 1, site] - falling[n, site]) * (larger / number)
            else:
                mean += falling[n + 1, site] - falling[n, site]
        out[site] = mean
