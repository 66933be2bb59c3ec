"""Logistic calibration and how it is judged."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.onboard.hazards.quadtree import site_probability as quadtree
from lunarsim.safety.logistic import Logistic


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


def test_files_are_checked(tmp_path):
    model = quadtree.measured()
    model.save(tmp_path / "m.json")
    assert Logistic.load(tmp_path / "m.json", quadtree.COUNT) == model
    for text in ("", "{}", '{"weights": [1, 2]}', '{"weights": "x"}'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(InputError, match="calibration"):
            Logistic.load(tmp_path / "bad.json", quadtree.COUNT)
