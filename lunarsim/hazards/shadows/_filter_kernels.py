"""Compiled part of the filter: a covariance less one outer product, in place."""

from __future__ import annotations

from lunarsim._jit import kernel, prange


@kernel(parallel=True)
def subtract_outer(p, w):
    """Subtract w w' from the square matrix p in place."""
    for i in prange(w.size):
        a = w[i]
        for j in range(w.size):
            p[i, j] -= a * w[j]
