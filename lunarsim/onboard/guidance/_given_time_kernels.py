# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled evaluation of paths with given times-to-go."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import evaluate_path


@kernel(shared=True)
def evaluate_given_times(thread_slice, state, targets, final, times, table, powers, params, out):
    """Evaluate the path with a given time-to-go to each target.

    `targets` (n, 3) are end positions, m, and `times` (n,) times-to-go, s. `out` (n, 4) receives
    delta-v, m/s (inf if a limit is violated or the time is NaN), time, s, maximum thrust, N, and
    maximum tangent of the tilt. `thread_slice` is (thread, number of threads); the other arguments
    are those of `evaluate_path`.
    """
    terms = np.empty((2, 3))
    for n in range(thread_slice[0], len(targets), thread_slice[1]):
        good = times[n] > 0.0 and evaluate_path(
            state, targets[n], final, times[n], table, powers, params, terms, out[n]
        )
        if not good:
            out[n, 0] = np.inf
            out[n, 1:] = np.nan
