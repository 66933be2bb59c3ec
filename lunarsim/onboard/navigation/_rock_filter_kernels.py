# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled in-place updates of a covariance matrix."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange


@kernel(parallel=True)
def add_outer_products(p, w):
    """Add w' w to the covariance p (n, n) in place, for w (m, n), in one pass."""
    for i in prange(len(p)):
        for k in range(len(w)):
            a = w[k, i]
            # The heights have no process noise, so a third of the entries is 0.
            if a != 0.0:
                for j in range(len(p)):
                    p[i, j] += a * w[k, j]


@kernel(parallel=True)
def subtract_square_from_rows(p, w, states):
    """Subtract w' w from the rows `states` (s,) of the covariance p (n, n), in place.

    `w` is (m, n). This is done row by row, which is limited by memory access for small m. The block
    of `states` stays exactly symmetric: each entry is reduced by the same products in the same
    order.
    """
    for k in prange(states.size):
        row = p[states[k]]
        for i in range(len(w)):
            a = w[i, states[k]]
            for j in range(row.size):
                row[j] -= a * w[i, j]


@kernel()
def subtract_product_from_rows(p, product, states):
    """Subtract the matrix `product` (k, n) from rows of a covariance, in place.

    `states` (k,) are the indices of the rows in the covariance p (n, n).
    """
    for k in range(states.size):
        row = p[states[k]]
        for j in range(row.size):
            row[j] -= product[k, j]


@kernel(parallel=True)
def mirror_columns(p, rows, columns):
    """Set p[rows, columns] to p[columns, rows]' in a covariance p, in place.

    `rows` and `columns` are disjoint index arrays. Blocks of eight rows use full cache lines if the
    rows are adjacent.
    """
    for block in prange((rows.size + 7) // 8):
        first = 8 * block
        last = min(first + 8, rows.size)
        for k in range(columns.size):
            source = p[columns[k]]
            for i in range(first, last):
                p[rows[i], columns[k]] = source[rows[i]]


@kernel(parallel=True)
def mirror_lower(p, states):
    """Make the block of the rows and columns `states` (s,) of p symmetric, in place.

    The upper triangle of the block is copied to the lower one.
    """
    for block in prange((states.size + 7) // 8):
        first = 8 * block
        last = min(first + 8, states.size)
        for k in range(last):
            source = p[states[k]]
            for i in range(max(first, k + 1), last):
                p[states[i], states[k]] = source[states[i]]


@kernel(parallel=True)
def multiply_pixel_jacobians(p, size, pose_indices, by_pose, rock_indices, by_rock):
    """Multiply rock-pixel Jacobians H by a covariance P; return H P (2 n, size).

    Each of the n rocks has two rows, for its two pixel coordinates. The only non-zero entries of H
    are the derivatives `by_pose` (n, 2, 6) with respect to the lander's pose and `by_rock` (n, 2,
    3) with respect to the rock's position. `pose_indices` (6,) and `rock_indices` (n, 3) locate
    these errors in P (`p`); `size` is the number of errors.
    """
    out = np.empty((2 * len(rock_indices), size))
    for k in prange(2 * len(rock_indices)):
        rock = k // 2
        axis = k % 2
        a0, a1, a2 = by_pose[rock, axis, 0], by_pose[rock, axis, 1], by_pose[rock, axis, 2]
        a3, a4, a5 = by_pose[rock, axis, 3], by_pose[rock, axis, 4], by_pose[rock, axis, 5]
        b0, b1, b2 = by_rock[rock, axis, 0], by_rock[rock, axis, 1], by_rock[rock, axis, 2]
        p0, p1, p2 = p[pose_indices[0]], p[pose_indices[1]], p[pose_indices[2]]
        p3, p4, p5 = p[pose_indices[3]], p[pose_indices[4]], p[pose_indices[5]]
        q0, q1, q2 = p[rock_indices[rock, 0]], p[rock_indices[rock, 1]], p[rock_indices[rock, 2]]
        row = out[k]
        for j in range(size):
            row[j] = (
                (a0 * p0[j] + a1 * p1[j] + a2 * p2[j])
                + (a3 * p3[j] + a4 * p4[j] + a5 * p5[j])
                + (b0 * q0[j] + b1 * q1[j] + b2 * q2[j])
            )
    return out
