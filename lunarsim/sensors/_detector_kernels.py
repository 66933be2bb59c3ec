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
    """Convert electrons (rows, cols) to `counts` (rows, cols), with noise.

    Where `has_shot_noise` is set, `electrons` already contains the shot noise; elsewhere its
    variance is the number of electrons. `standard_normal` are random numbers (rows, cols) for the
    noise; `read_variance` is the variance of the read noise, electrons^2.
    """
    rows, cols = counts.shape
    for i in prange(rows):
        for j in range(cols):
            variance = read_variance if has_shot_noise[i, j] else read_variance + electrons[i, j]
            count = electrons[i, j] + np.sqrt(variance) * standard_normal[i, j]
            count = min(count, full_well) * counts_per_electron
            # NaN gives a count of 0.
            counts[i, j] = np.rint(min(count, max_count)) if count > 0.0 else np.float32(0.0)
