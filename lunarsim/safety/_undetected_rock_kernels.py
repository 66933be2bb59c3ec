# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled means of ratios over the rocks of a size distribution."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel(shared=True)
def mean_ratios(
    thread_slice,
    height,
    ratios,
    min_diameter,
    numbers,
    min_height,
    height_ratio,
    first_log_diameter,
    log_step,
    log_numbers,
    out,
):
    """Write the mean remaining fraction of undetected rocks above a height (sites,).

    `out` (sites,) receives the mean over the rocks of the size distribution: `numbers` are the
    rocks per m^2 above `min_diameter` of each class (classes,), and `log_numbers` (n,) the log of
    the rocks per m^2 above diameters whose logarithms start at `first_log_diameter` and are
    `log_step` apart. `ratios` (classes + 1, sites) are the fractions that remain in each class,
    starting with rocks smaller than all classes. `height` is (1,) or (sites,), m; lower heights
    count as `min_height`, and NaN gives NaN. `height_ratio` is height over diameter of a rock.
    `thread_slice` is (first site, step between sites) of one thread.
    """
    last = log_numbers.size - 2
    for site in range(thread_slice[0], out.size, thread_slice[1]):
        above = height[site if height.size > 1 else 0]
        if np.isnan(above):
            out[site] = np.nan
            continue
        d = max(above, min_height) / height_ratio
        at = min(max((np.log(d) - first_log_diameter) / log_step, 0.0), last + 1.0)
        k = min(int(at), last)
        number = np.exp(log_numbers[k] + (at - k) * (log_numbers[k + 1] - log_numbers[k]))
        mean = ratios[0, site]
        for n in range(min_diameter.size):
            # Fraction of the rocks above the height in this class or a larger one.
            larger = numbers[n] if d < min_diameter[n] else number
            if number > 0.0:
                mean += (ratios[n + 1, site] - ratios[n, site]) * (larger / number)
            else:
                mean += ratios[n + 1, site] - ratios[n, site]
        out[site] = mean
