from __future__ import annotations

import numpy as np
import pytest

from lunarsim.evaluation.classification import classify


def test_classification_counts():
    p = np.array([[0.001, 0.001, 0.9, 0.9, 0.5]], np.float32)
    occupied = np.array([[False, True, True, False, False]])
    rates = classify(p, occupied, observed=np.ones_like(occupied)).rates
    assert rates == {
        "clear_recall": pytest.approx(1 / 3), "occupied_called_clear": 0.5, "clear_false": 0.5,
        "occupied_correct": 0.5, "called_clear": pytest.approx(0.4), "unknown": pytest.approx(0.2),
    }  # fmt: skip


def test_what_was_never_seen_is_not_clear_however_few_rocks_are_expected():
    p = np.array([[0.0002, 0.0002, 0.9]], np.float32)
    occupied = np.array([[False, True, True]])
    blind = classify(p, occupied, observed=np.zeros_like(occupied))
    assert blind.called_clear == blind.clear_right == blind.clear_wrong == 0
    assert blind.occupied_right == 1
    one = classify(p, occupied, observed=np.array([[True, False, False]]))
    assert (one.called_clear, one.clear_right, one.clear_wrong) == (1, 1, 0)
