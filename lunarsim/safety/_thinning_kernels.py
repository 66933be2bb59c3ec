"""Compiled means of ratios over the rocks of a law."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel(shared=True)
def mean_ratios(share, height, falling, least, numbers, shortest, ratio, first, step, law, out):
    """Write the mean of ratios over the law's rocks above a height at each site.

    Parameters
    ----------
    share
        First site and step.
    height
        Of all sites (1,) or of each (sites,), m; less than `shortest` counts as that, and NaN gives
        NaN.
    falling
        Ratios (classes + 1, sites), those of rocks smaller than all classes first.
    least, numbers
        Least diameter of each class (classes,), m, and the law's rocks above it.
    shortest, ratio
        m, and height over diameter.
    first, step, law
        Logarithms of the law's numbers (n,) at diameters whose logarithms begin at `first` and are
        `step` apart.
    out
        (sites,).
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
        for n in range(least.size):
            # Share of the rocks above the height that are of this class or a larger one.
            larger = numbers[n] if d < least[n] else number
            if number > 0.0:
                mean += (falling[n + 1, site] - falling[n, site]) * (larger / number)
            else:
                mean += falling[n + 1, site] - falling[n, site]
        out[site] = mean
