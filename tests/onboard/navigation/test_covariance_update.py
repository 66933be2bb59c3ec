"""Test subtractions from a covariance by blocks and rows, with several threads."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from lunarsim.onboard.navigation.schmidt_kalman_covariance import subtract_rows, subtract_square


@pytest.mark.parametrize("measured", [1, 3, 6, 7, 40])
def test_covariance_update_is_the_same_on_any_number_of_threads(measured):
    rng = np.random.default_rng(3)
    w = rng.standard_normal((measured, 1000))
    states = rng.permutation(1000)[:300]
    whole = rng.standard_normal((1000, 1000))
    whole += whole.T
    before = numba.get_num_threads()
    results = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            p, some = whole.copy(), whole.copy()
            subtract_square(p, w)
            subtract_rows(some, w, states)
            results.append((p, some))
    finally:
        numba.set_num_threads(before)
    (p, some), (other, some_other) = results
    expected = whole - w.T @ w
    assert np.array_equal(p, other)
    assert np.array_equal(some, some_other)
    assert np.array_equal(p, p.T)
    assert np.allclose(p, expected, atol=1e-9)
    # Only the rows are updated, and the columns within the block of the states.
    rest = np.setdiff1d(np.arange(1000), states)
    expected[rest] = whole[rest]
    assert np.allclose(some, expected, atol=1e-9)
    own = some[np.ix_(states, states)]
    assert np.array_equal(own, own.T)
