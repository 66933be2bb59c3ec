from __future__ import annotations

import numpy as np
import pytest

from lunarsim.evaluation.classification import classify


def test_classification_counts():
    p = np.array([[0.001, 0.001, 0.9, 0.9, 0.5]], np.float32)
    occupied = np.array([[False, True, True, False, False]])
    rates = classify(p, occupied).rates
    assert rates == {
        "clear_recall": pytest.approx(1 / 3), "occupied_called_clear": 0.5, "clear_false": 0.5,
        "occupied_correct": 0.5, "unknown": pytest.approx(0.2),
    }  # fmt: skip
