from __future__ import annotations

import numpy as np
import pytest

from lunarsim.evaluation.consistency import Consistency, normalised_squared_error


def drawn(scale, trials=400, seed=0):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4))
    covariance = root @ root.T + np.eye(4)
    factor = np.linalg.cholesky(covariance)
    found = Consistency()
    for _ in range(trials):
        error = scale * factor @ rng.standard_normal(4)
        found = found.plus(normalised_squared_error(error, covariance), 4)
    return found


def test_true_covariances_hold_and_wrong_ones_do_not():
    assert np.mean([drawn(1.0, 60, seed).holds() for seed in range(60)]) > 0.85
    assert not drawn(1.15).holds(0.99)
    assert not drawn(0.85).holds(0.99)
    assert drawn(2.0).ratio == pytest.approx(4.0, rel=0.1)


def test_closed_forms():
    assert normalised_squared_error([3.0, 4.0], np.diag([9.0, 4.0])) == pytest.approx(5.0)
    assert np.isnan(Consistency().ratio)
    low, high = Consistency(1.0, 2).bounds(0.9)
    # Two degrees of freedom: an exponential law.
    assert (low, high) == pytest.approx((-np.log(0.95), -np.log(0.05)))
