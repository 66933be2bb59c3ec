"""Compiled part of a camera's detector: noise, well and converter in one pass over the pixels."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange


@kernel(parallel=True)
def read_out(counts, electrons, normal, few, noise, well, factor, top):
    """Write the counts (rows, cols) of electrons (rows, cols).

    Parameters
    ----------
    counts
        Of an unsigned type.
    electrons
        On each pixel; where photons are few as many as came.
    normal
        Standard normal numbers (rows, cols).
    few
        Where photons are few; elsewhere they vary by the root of their number (rows, cols).
    noise
        Variance of reading, electrons^2.
    well, factor, top
        Electrons at most, counts for each, and the greatest count.
    """
    rows, cols = counts.shape
    for i in prange(rows):
        for j in range(cols):
            variance = noise if few[i, j] else noise + electrons[i, j]
            count = electrons[i, j] + np.sqrt(variance) * normal[i, j]
            count = min(count, well) * factor
            # What is no number counts nothing.
            counts[i, j] = np.rint(min(count, top)) if count > 0.0 else np.float32(0.0)
