"""Compiled sampling of a triad."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def sample(truth, matrix, offset, quantum, remainder, out):
    """Write the increment (3,) of a triad for a true one; keep what is no whole quantum.

    The sum is rounded, not the increments, so that no angle or velocity is lost.
    """
    for i in range(3):
        x = offset[i]
        for j in range(3):
            x += matrix[i, j] * truth[j]
        if quantum > 0.0:
            total = remainder[i] + x
            x = quantum * np.rint(total / quantum)
            remainder[i] = total - x
        out[i] = x
