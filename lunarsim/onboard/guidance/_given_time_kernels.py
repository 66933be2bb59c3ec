# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled evaluation of paths with given times-to-go."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import evaluate_path


@kernel(shared=True)
def evaluate_given_times(share, state, targets, final, times, table, powers, params, out):
    """Evaluate the path of a given time (n,), s, to each target (n, 3).

    Writes (n, 4) as `_reach_kernels.survey`: delta-v (inf if a limit is violated or the time is
    NaN), time, maximum thrust (N) and maximum tangent of the tilt.
    """
    x = np.empty((2, 3))
    for n in range(share[0], len(targets), share[1]):
        good = times[n] > 0.0 and evaluate_path(
            state, targets[n], final, times[n], table, powers, params, x, out[n]
        )
        if not good:
            out[n, 0] = np.inf
            out[n, 1:] = np.nan
