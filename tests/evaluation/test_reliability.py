from __future__ import annotations

import numpy as np
import pytest

from lunarsim.evaluation.reliability import calibration_error, frequencies, reliability


def test_reliability_counts_by_bin():
    p = np.array([0.0, 0.01, 0.55, 0.55, 0.99, 1.0])
    table = reliability(p, [0, 1, 1, 0, 1, 1])
    assert table[:, 0].sum() == 6
    assert table[0] == pytest.approx([2, 0.01, 1])
    assert table[-1] == pytest.approx([2, 1.99, 2])
    mean, share = frequencies(table)
    assert (mean[0], share[0]) == pytest.approx((0.005, 0.5))
    assert np.isnan(mean[3])
    assert np.isnan(share[3])
    expected = (2 * abs(0.005 - 0.5) + 2 * abs(0.55 - 0.5) + 2 * abs(0.995 - 1.0)) / 6
    assert calibration_error(table) == pytest.approx(expected)
