"""Test the last calibration stage of the fused map and its second map."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.special import expit, logit

from lunarsim.errors import InputError
from lunarsim.onboard.calibration.fused import FusedCalibration
from lunarsim.onboard.hazards.fusion import FusedMapper, FusedMapperSettings
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapperSettings
from lunarsim.onboard.hazards.quadtree.mapper import QuadtreeMapperSettings
from tests.made_mapper import TERMS, Made


def test_left_as_it_is_it_changes_no_bit():
    p = np.random.default_rng(0).random(1000, np.float32)
    assert np.array_equal(FusedCalibration().probability(p, p[::-1], p > 0.5), p)


@pytest.mark.parametrize("weights", [(0.4, 0.8, 0.3), (-0.5, 1.6, 0.1), (1.0, 0.0, 2.0)])
def test_it_rises_with_either_map_and_stays_close_to_the_first(weights):
    rng = np.random.default_rng(1)
    c = FusedCalibration(*weights)
    p, q = np.sort(rng.uniform(0.01, 0.99, (2, 400)))
    assert (np.diff(c.probability(p, np.full(400, q[100]), True)) >= 0.0).all()
    assert (np.diff(c.probability(np.full(400, p[100]), q, True)) >= 0.0).all()
    changed = c.probability(p, q[rng.permutation(400)], True)
    assert np.abs(logit(changed.astype(float)) - logit(p)).max() < 2.001
    assert c.probability(np.zeros(3), np.ones(3), True).tolist() == [0.0] * 3
    # Cells without an observation in the second map are ignored.
    unseen = c.probability(p, q, False)
    assert np.array_equal(unseen, FusedCalibration(*weights[:2]).probability(p, q, True))


def test_a_fit_finds_what_the_second_map_knows():
    rng = np.random.default_rng(2)
    x, y = rng.normal(0.0, 2.0, (2, 40_000))
    seen = rng.random(40_000) < 0.7
    truth = expit(0.3 + 0.9 * x + np.where(seen, 0.5 * y, 0.0))
    safe = rng.random(40_000) < truth
    found = FusedCalibration.fit(expit(x), expit(y), seen, safe, ~safe)
    assert (found.intercept, found.slope, found.other) == pytest.approx((0.3, 0.9, 0.5), abs=0.05)
    # An uninformative second map gets no weight, and few sites change little.
    told = FusedCalibration.fit(expit(x), expit(-y), seen, safe, ~safe)
    assert told.other == 0.0
    few = FusedCalibration.fit(expit(x), expit(y), seen, safe, ~safe, site_weight=1e-6)
    assert (few.intercept, few.slope, few.other) == pytest.approx((0.0, 1.0, 0.0), abs=0.05)
    with pytest.raises(InputError, match="safe and unsafe sites"):
        FusedCalibration.fit([0.5], [0.5], [True], [3], [0])


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "does not exist"), ("{", "JSON"), ("[]", "format"),
        ({"intercept": 0.0, "slope": 1.0}, "is missing"),
        ({"intercept": 0.0, "slope": -1.0, "other": 0.0}, "0 or more"),
        ({"intercept": "x", "slope": 1.0, "other": 0.0}, "a finite number"),
        ({"intercept": 0.0, "slope": 1e999, "other": 0.0}, "finite"),
    ],
)  # fmt: skip
def test_a_file_that_is_none_is_refused(tmp_path, content, told):
    file = tmp_path / "c.json"
    if isinstance(content, str):
        file.write_text(content)
    elif content is not None:
        file.write_text(json.dumps({"format": "lunarsim fused calibration 1"} | content))
    with pytest.raises(InputError, match=told) as error:
        FusedMapperSettings(calibration_path=file)
    assert error.value.field == "calibration_path"


def test_the_mapper_looks_at_the_second_map_without_being_made_of_it(tmp_path):
    c = FusedCalibration(0.2, 1.1, 0.4)
    c.save(tmp_path / "c.json")
    assert FusedCalibration.load(tmp_path / "c.json") == c
    own, second = Made(), Made()
    fused = FusedMapper({"own": own}, TERMS, c, {"second": second})
    assert fused.source_mappers == {"own", "second"}
    own.update(0.7, None)
    expected = c.probability(np.float32([0.7]), [0.0], [False])
    assert (fused.hazard_map().p_safe == expected).all()
    # The map is updated when the second map is.
    second.update(0.9, None)
    expected = c.probability(np.float32([0.7]), np.float32([0.9]), [True])
    assert (fused.hazard_map().p_safe == expected).all()
    assert expected > 0.7
    alone = FusedMapper({"own": own}, TERMS, FusedCalibration(0.2))
    assert (alone.hazard_map().p_safe == FusedCalibration(0.2).probability([0.7], 0, False)).all()


def test_a_feature_is_a_second_map_of_elevations_with_a_weight(tmp_path):
    FusedCalibration(other=0.4).save(tmp_path / "c.json")
    file = tmp_path / "c.json"
    with pytest.raises(InputError, match=r"calibration_mapper: .* got 'tree'"):
        FusedMapperSettings(calibration_mapper="tree")
    with pytest.raises(InputError, match="if calibration_mapper is omitted"):
        FusedMapperSettings(calibration_path=file)
    part = FusedMapperSettings(calibration_path=file, calibration_mapper="tree")
    parts = {"dem": GaussianDemMapperSettings(), "tree": QuadtreeMapperSettings(), "all": part}
    assert list(part.fused_mappers(parts)) == ["dem"]
    for wrong in ("trea", "all", "dem"):
        other = FusedMapperSettings(("dem",), calibration_path=file, calibration_mapper=wrong)
        with pytest.raises(InputError) as error:
            other.fused_mappers(parts)
        assert error.value.field == "calibration_mapper"
