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
def _squared(constant, linear, factor, displacement, out, column):
    """Expand ``|constant + linear u + factor displacement u^2|^2`` in powers of u.

    A squared jerk or snap is a power of u, the inverse time-to-go, times this polynomial. `factor`
    is a number, the others are vectors (3,). A `column` of `out` (5, 16) receives the coefficients,
    u^0 first.
    """
    out[0, column] = _dot(constant, constant)
    out[1, column] = 2.0 * _dot(constant, linear)
    out[2, column] = _dot(linear, linear) + 2.0 * factor * _dot(constant, displacement)
    out[3, column] = 2.0 * factor * _dot(linear, displacement)
    out[4, column] = factor * factor * _dot(displacement, displacement)


@kernel(inline=True)
def _polynomial(coefficients, column, u):
    """Return the value at `u` of the quartic polynomial in a column of `coefficients`.

    `coefficients` (5, 16) has one polynomial per column, the constant term first.
    """
    return coefficients[0, column] + u * (
        coefficients[1, column]
        + u
        * (coefficients[2, column] + u * (coefficients[3, column] + u * coefficients[4, column]))
    )


@kernel(inline=True)
def _is_within_limits(terms, column, inverse_time, max_squares):
    """Return whether a path with a given time-to-go keeps the limits of jerk and snap.

    A column of `terms` (3, 5, 16) has the polynomials of squared jerk at start and end and of
    squared snap for one target; `inverse_time` is one over the time-to-go. `max_squares` (2,) is
    ``(jerk / 6)^2`` and ``(snap / 12)^2``. NaN gives False.
    """
    square = inverse_time * inverse_time
    start, end = (
        _polynomial(terms[0], column, inverse_time) * square,
        _polynomial(terms[1], column, inverse_time) * square,
    )
    snap = _polynomial(terms[2], column, inverse_time) * square * square
    return (start <= max_squares[0]) & (end <= max_squares[0]) & (snap <= max_squares[1])


@kernel(inner=True)
def _refine(terms, low, high, max_squares):
    """Bisect the brackets of 16 minimum times-to-go, in place.

    `low` and `high` (16,), s, are the ends of the brackets, one per target: a path of time `low`
    violates the limit of jerk or snap, a path of time `high` keeps both limits. `terms` and
    `max_squares` are those of `_is_within_limits`.
    """
    for _ in range(_HALVINGS):
        for k in range(_BLOCK):
            middle = 0.5 * (low[k] + high[k])
            good = _is_within_limits(terms, k, 1.0 / middle, max_squares)
            low[k] = low[k] if good else middle
            high[k] = middle if good else high[k]


@kernel(shared=True)
def min_times_to_go(thread_slice, position, velocity, targets, v_f, a_f, times, jerk, snap, out):
    """Find the minimum time-to-go within the limits of jerk and snap for each target.

    The path leads from `position` and `velocity` (3,) to `targets` (n, 3) with final velocity `v_f`
    and acceleration `a_f` (3,), SI. `times` (m,), s, are tried in ascending order; the interval up
    to the first one that keeps the limits `jerk` (m/s^3) and `snap` (m/s^4) is bisected 40 times.
    `out` (n,) receives the minimum times, s, or NaN if none of `times` keeps the limits.
    `thread_slice` is (thread, number of threads).
    """
    count, inverse, good = targets.shape[0], 1.0 / times, np.empty(len(times), np.bool_)
    terms, displacement, still = np.empty((3, 5, _BLOCK)), np.empty(3), -a_f
    start, end, fourth = (
        -(5.0 * v_f + 3.0 * velocity),
        3.0 * v_f + velocity,
        -(4.0 * v_f + 2.0 * velocity),
    )
    max_squares = np.array([(jerk / 6.0) ** 2, (snap / 12.0) ** 2])
    low, high = np.empty(_BLOCK), np.empty(_BLOCK)
    for block in range(thread_slice[0], (count + _BLOCK - 1) // _BLOCK, thread_slice[1]):
        first_target = block * _BLOCK
        for k in range(_BLOCK):
            for x in range(3):
                displacement[x] = targets[min(first_target + k, count - 1), x] - position[x]
            _squared(a_f, start, 8.0, displacement, terms[0], k)
            _squared(still, end, -4.0, displacement, terms[1], k)
            _squared(a_f, fourth, 6.0, displacement, terms[2], k)
            for m in range(len(times)):
                good[m] = _is_within_limits(terms, k, inverse[m], max_squares)
            m = 0
            while m < len(times) and not good[m]:
                m += 1
            high[k] = times[m] if m < len(times) else np.nan
            low[k] = times[max(m - 1, 0)]
        _refine(terms, low, high, max_squares)
        for k in range(min(_BLOCK, count - first_target)):
            out[first_target + k] = high[k]
