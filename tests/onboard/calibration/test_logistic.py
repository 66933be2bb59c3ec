"""Logistic calibration and how it is judged."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.onboard.calibration.logistic import Logistic


def test_a_known_law_is_recovered():
    rng = np.random.default_rng(0)
    x = np.column_stack((np.ones(20_000), rng.normal(0.0, 1.0, (20_000, 3))))
    law = Logistic((1.0, -2.0, 0.5, 0.0))
    found = Logistic.fit(x, rng.random(20_000) < law.probability(x))
    assert np.array(found.weights) == pytest.approx(law.weights, abs=0.1)
    table = reliability(found.probability(x), rng.random(20_000) < law.probability(x))
    assert calibration_error(table) < 0.015
    with pytest.raises(InputError, match=r"calibration\.safe"):
        Logistic.fit(x, np.ones(20_000))


def test_steps_that_begin_elsewhere_end_at_the_same_weights():
    rng = np.random.default_rng(1)
    x = np.column_stack((np.ones(5000), rng.uniform(0.0, 1.0, (5000, 4))))
    y = rng.random(5000) < Logistic((-1.0, 2.0, -1.0, 0.5, 0.0)).probability(x)
    plain = Logistic.fit(x, y, rising=4)
    moved = Logistic.fit(x, y, rising=4, start=(3.0, 0.0, 2.0, 0.0, 5.0))
    assert np.array(moved.weights) == pytest.approx(plain.weights, abs=1e-3)
    assert min(plain.weights[1:]) == 0.0
