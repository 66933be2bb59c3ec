# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled camera detector: noise, saturation and quantization."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange


@kernel(parallel=True)
def read_out(
    counts,
    electrons,
    standard_normal,
    has_shot_noise,
    read_variance,
    full_well,
    counts_per_electron,
    max_count,
):
    """Write the counts of a detector for given electrons into `counts` (rows, cols).

    Where `has_shot_noise` (rows, cols) is set, `electrons` (rows, cols) already contain the shot
    noise; elsewhere it is added with the variance `electrons`. The read noise has the variance
    `read_variance`, electrons^2. `standard_normal` (rows, cols) are the random numbers of both
    kinds of noise. The noisy electrons are limited to `full_well`, multiplied by
    `counts_per_electron`, limited to `max_count` and rounded. Negative values and NaN become 0.
    """
    rows, cols = counts.shape
    for i in prange(rows):
        for j in range(cols):
            variance = read_variance if has_shot_noise[i, j] else read_variance + electrons[i, j]
            count = electrons[i, j] + np.sqrt(variance) * standard_normal[i, j]
            count = min(count, full_well) * counts_per_electron
            # NaN gives a count of 0.
            counts[i, j] = np.rint(min(count, max_count)) if count > 0.0 else np.float32(0.0)
