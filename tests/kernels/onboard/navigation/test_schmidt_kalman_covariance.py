"""Mirroring of rows and columns of a covariance."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.navigation._rock_filter_kernels import mirror_columns, mirror_lower


def test_columns_are_taken_over_mirrored():
    rng = np.random.default_rng(9)
    p = rng.normal(size=(70, 70))
    order = rng.permutation(70)
    rows, columns = order[:37], order[37:60]
    expected = p.copy()
    for row in rows:
        for column in columns:
            expected[row, column] = p[column, row]
    mirror_columns(p, rows, columns)
    assert np.array_equal(p, expected)


def test_of_two_states_the_later_ones_row_takes_over():
    rng = np.random.default_rng(10)
    p = rng.normal(size=(70, 70))
    states = rng.permutation(70)[:37]
    expected = p.copy()
    for late in range(len(states)):
        for early in range(late):
            expected[states[late], states[early]] = p[states[early], states[late]]
    mirror_lower(p, states)
    assert np.array_equal(p, expected)
