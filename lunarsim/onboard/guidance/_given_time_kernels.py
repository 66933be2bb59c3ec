# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled evaluation of paths with given times-to-go."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import evaluate_path


@kernel(shared=True)
def evaluate_given_times(share, state, targets, final, times, table, powers, params, out):
    """Evaluate the path with a given time-to-go to each target.

    `targets` (n, 3) are end positions, m, and `times` (n,) times-to-go, s. `state` and `final` (2,
    3) are current position and velocity, and final velocity and acceleration. `table`, `powers` and
    `params` are those of `evaluate_path`. `out` (n, 4) receives delta-v, m/s (inf if a limit is
    violated or the time is NaN), time, s, maximum thrust, N, and maximum tangent of the tilt.
    `share` is (thread, number of threads).
    """
    x = np.empty((2, 3))
    for n in range(share[0], len(targets), share[1]):
        good = times[n] > 0.0 and evaluate_path(
            state, targets[n], final, times[n], table, powers, params, x, out[n]
        )
        if not good:
            out[n, 0] = np.inf
            out[n, 1:] = np.nan
