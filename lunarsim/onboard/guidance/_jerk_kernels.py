# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled search for the minimum time-to-go within limits on jerk and snap.

With u = 1 / T and d the displacement to the target, a quartic path's jerk at its start and end and
its snap are ``6 u (a_f - (5 v_f + 3 v) u + 8 d u^2)``, ``6 u (-a_f + (3 v_f + v) u - 4 d u^2)`` and
``12 u^2 (a_f - (4 v_f + 2 v) u + 6 d u^2)``. Jerk is linear in time, so its maximum is at an end;
snap is constant. Their squares are polynomials of u; three coefficients depend on the target.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

_BLOCK = 16  # number of targets that are refined together, for SIMD
_HALVINGS = 40  # bisections of a bracket


@kernel(inner=True)
def _dot(a, b):
    """Return the scalar product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(inner=True)
def _squared(a, b, c, way, out, k):
    """Compute the polynomial coefficients of ``|a + b u + c way u^2|^2``.

    `a`, `b` and `way` are vectors (3,) and `c` is a number. Column `k` of `out` (5, 16) receives
    the coefficients, u^0 first.
    """
    out[0, k] = _dot(a, a)
    out[1, k] = 2.0 * _dot(a, b)
    out[2, k] = _dot(b, b) + 2.0 * c * _dot(a, way)
    out[3, k] = 2.0 * c * _dot(b, way)
    out[4, k] = c * c * _dot(way, way)


@kernel(inline=True)
def _polynomial(c, k, u):
    """Return the value at `u` of the quartic polynomial in column `k` of `c` (5, 16)."""
    return c[0, k] + u * (c[1, k] + u * (c[2, k] + u * (c[3, k] + u * c[4, k])))


@kernel(inline=True)
def _is_within_limits(terms, k, u, most):
    """Return whether the path to target `k` keeps the limits of jerk and snap.

    `terms` (3, 5, 16) are the polynomials of squared jerk at start and end and of squared snap; `u`
    is the inverse of the time-to-go. `most` (2,) is ``(jerk / 6)^2`` and ``(snap / 12)^2``. NaN
    gives False.
    """
    square = u * u
    start, end = _polynomial(terms[0], k, u) * square, _polynomial(terms[1], k, u) * square
    snap = _polynomial(terms[2], k, u) * square * square
    return (start <= most[0]) & (end <= most[0]) & (snap <= most[1])


@kernel(inner=True)
def _refine(terms, low, high, most):
    """Bisect 16 time brackets between a violated and a kept limit, in place.

    `low` and `high` (16,), s, are the brackets; only the lower ends violate a limit. `terms` and
    `most` are those of `_is_within_limits`.
    """
    for _ in range(_HALVINGS):
        for k in range(_BLOCK):
            middle = 0.5 * (low[k] + high[k])
            good = _is_within_limits(terms, k, 1.0 / middle, most)
            low[k] = low[k] if good else middle
            high[k] = middle if good else high[k]


@kernel(shared=True)
def min_times_to_go(share, r, v, targets, v_f, a_f, times, jerk, snap, out):
    """Find the minimum time-to-go within the limits of jerk and snap for each target.

    `r` and `v` (3,) are current position and velocity, `targets` (n, 3) end positions, `v_f` and
    `a_f` (3,) final velocity and acceleration. `times` (m,), s, ascend; the minimum is bracketed by
    them and bisected 40 times. `out` (n,) receives the times, s, NaN if no time keeps the limits.
    `share` is (thread, number of threads).
    """
    count, inverse, good = targets.shape[0], 1.0 / times, np.empty(len(times), np.bool_)
    terms, way, still = np.empty((3, 5, _BLOCK)), np.empty(3), -a_f
    start, end, fourth = -(5.0 * v_f + 3.0 * v), 3.0 * v_f + v, -(4.0 * v_f + 2.0 * v)
    most = np.array([(jerk / 6.0) ** 2, (snap / 12.0) ** 2])
    low, high = np.empty(_BLOCK), np.empty(_BLOCK)
    for block in range(share[0], (count + _BLOCK - 1) // _BLOCK, share[1]):
        here = block * _BLOCK
        for k in range(_BLOCK):
            for x in range(3):
                way[x] = targets[min(here + k, count - 1), x] - r[x]
            _squared(a_f, start, 8.0, way, terms[0], k)
            _squared(still, end, -4.0, way, terms[1], k)
            _squared(a_f, fourth, 6.0, way, terms[2], k)
            for m in range(len(times)):
                good[m] = _is_within_limits(terms, k, inverse[m], most)
            m = 0
            while m < len(times) and not good[m]:
                m += 1
            high[k] = times[m] if m < len(times) else np.nan
            low[k] = times[max(m - 1, 0)]
        _refine(terms, low, high, most)
        for k in range(min(_BLOCK, count - here)):
            out[here + k] = high[k]
