# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled camera detector: noise, saturation and quantization."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange


@kernel(parallel=True)
def read_out(counts, electrons, normal, few, noise, well, factor, top):
    """Convert electrons (rows, cols) to `counts` (rows, cols), with noise.

    Where `few` is set, `electrons` already contains the shot noise; elsewhere its variance is the
    number of electrons. `normal` holds standard normal numbers, `noise` the variance of the read
    noise (electrons^2), `well` the maximum of electrons, `factor` counts per electron and `top` the
    maximum count.
    """
    rows, cols = counts.shape
    for i in prange(rows):
        for j in range(cols):
            variance = noise if few[i, j] else noise + electrons[i, j]
            count = electrons[i, j] + np.sqrt(variance) * normal[i, j]
            count = min(count, well) * factor
            # NaN gives a count of 0.
            counts[i, j] = np.rint(min(count, top)) if count > 0.0 else np.float32(0.0)
