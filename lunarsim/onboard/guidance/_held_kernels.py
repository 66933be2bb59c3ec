"""Compiled measure of paths whose times-to-go are given: no other time is tried."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import measure


@kernel(shared=True)
def measured(share, state, targets, asked, times, table, powers, figures, out):
    """Write what the path to each target (n, 3) takes that lasts so long (n,), s.

    As `_reach_kernels.survey` writes it (n, 4): the increment (inf where a limit is broken, or the
    time is NaN), the time, the greatest thrust (N) and the greatest tangent of its lean.
    """
    x = np.empty((2, 3))
    for n in range(share[0], len(targets), share[1]):
        good = times[n] > 0.0 and measure(
            state, targets[n], asked, times[n], table, powers, figures, x, out[n]
        )
        if not good:
            out[n, 0] = np.inf
            out[n, 1:] = np.nan
