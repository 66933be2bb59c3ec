from __future__ import annotations

import numpy as np
import pytest

from lunarsim.evaluation.reliability import (
    bin_frequencies,
    calibration_error,
    chance_calibration_error,
    reliability,
)


def test_reliability_counts_by_bin():
    p = np.array([0.0, 0.01, 0.55, 0.55, 0.99, 1.0])
    table = reliability(p, [0, 1, 1, 0, 1, 1])
    assert table[:, 0].sum() == 6
    assert table[0] == pytest.approx([2, 0.01, 1])
    assert table[-1] == pytest.approx([2, 1.99, 2])
    mean, share = bin_frequencies(table)
    assert (mean[0], share[0]) == pytest.approx((0.005, 0.5))
    assert np.isnan(mean[3])
    assert np.isnan(share[3])
    expected = (2 * abs(0.005 - 0.5) + 2 * abs(0.55 - 0.5) + 2 * abs(0.995 - 1.0)) / 6
    assert calibration_error(table) == pytest.approx(expected)


def test_correct_probabilities_stay_under_the_chance_error_as_often_as_stated():
    rng = np.random.default_rng(2)
    for count in (8, 60, 400):
        p = rng.uniform(0.6, 1.0, count)
        bound = chance_calibration_error(p, rng, quantile=0.9)
        found = [calibration_error(reliability(p, rng.random(count) < p)) for _ in range(400)]
        assert np.mean(np.array(found) <= bound) == pytest.approx(0.9, abs=0.06)
    # Eight sites told to be safe at 0.964, and safe: nothing is known against that.
    few = np.full(8, 0.964)
    error = calibration_error(reliability(few, np.ones(8)))
    assert error == pytest.approx(0.036)
    assert error < chance_calibration_error(few, rng)
    assert np.isnan(chance_calibration_error([], rng))
