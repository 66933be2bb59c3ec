"""Regressions without one world each: what they agree on, and that the lowest counts."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit

from lunarsim.errors import InputError
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    ALMOST_CERTAINLY_UNSAFE_P,
    LOG_ODDS_MARGIN,
    MAX_CLAIM_DEFICIT,
    conservative_probability,
)
from lunarsim.onboard.calibration.ensemble import Ensemble, LogOddsBounds
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM
from lunarsim.onboard.calibration.logistic import Logistic
from lunarsim.onboard.calibration.monotone_splines import MonotoneSplineTerm, spline_features
from lunarsim.onboard.calibration.quadtree import QUADTREE


@given(st.integers(0, 10_000), st.integers(1, 5), st.booleans())
def test_odds_of_terms_are_those_of_their_features(seed, fits, each):
    rng = np.random.default_rng(seed)
    n = 40
    knots = [np.sort(rng.normal(0.0, 1.0, k)) for k in (2, 3, 7)]
    terms = [
        MonotoneSplineTerm(rng.normal(0.0, 1.5, n), x, bool(rng.random() < 0.5)) for x in knots
    ]
    # At a knot, and where all sites share a value.
    terms[1].values[:3] = knots[1]
    terms.insert(1, MonotoneSplineTerm(np.array(rng.normal()), np.array([-1.0, 0.0, 1.0])))
    free = rng.normal(0.0, 1.0, (n, 2) if each else 2)
    x = np.column_stack((np.broadcast_to(free, (n, 2)), spline_features(terms, n)))
    model = Ensemble(tuple(map(tuple, rng.normal(0.0, 2.0, (fits, x.shape[1])))))
    found, wanted = model.evaluate_log_odds(free, terms), [
        [sum(w * v for w, v in zip(row, site, strict=True)) for row in model.weights] for site in x
    ]  # fmt: skip
    assert found.low == pytest.approx(np.min(wanted, axis=1), abs=1e-9)
    assert found.high == pytest.approx(np.max(wanted, axis=1), abs=1e-9)
    of_features = model.evaluate_features(x)
    assert of_features.low == pytest.approx(found.low, abs=1e-9)
    assert of_features.high == pytest.approx(found.high, abs=1e-9)


def test_fits_agree_where_all_call_a_site_surely_safe_or_surely_not():
    low = np.array([-9.0, -9.0, -3.0, 0.0, 3.6, 3.8, 3.8, 9.0])
    apart = np.array([2.0, 6.5, 0.05, 0.0, 0.1, 0.8, 2.5, 5.0])
    said = LogOddsBounds(low, low + apart).estimate(np.ones(8))
    assert (
        expit(3.6 - LOG_ODDS_MARGIN)
        < ALMOST_CERTAINLY_SAFE_P
        < (1.0 - MAX_CLAIM_DEFICIT) * expit(3.8 - LOG_ODDS_MARGIN)
    )
    assert expit(-2.95) < ALMOST_CERTAINLY_UNSAFE_P < expit(-2.5)
    assert said.agreed.tolist() == [True, False, True, False, False, True, True, True]
    # Twice as often unsafe as by the lowest, and at least as often as no world can tell.
    assert (1.0 - MAX_CLAIM_DEFICIT) / said.p - 1.0 == pytest.approx(2.0 * np.exp(-low))
    assert said.p.max() < 1.0 - MAX_CLAIM_DEFICIT
    # What is fatal by itself leaves it neither safe nor told.
    said = LogOddsBounds(low, low + apart).estimate(np.full(8, 0.5))
    assert said.p.max() == 0.5
    assert said.agreed.tolist() == [True, False, True, *[False] * 5]


@given(st.floats(-8.0, 12.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.7, 4.0))
def test_where_nothing_is_claimed_nothing_is_surely_safe(low, most, least, margin):
    said = [np.array([v]) for v in (low, most, least)]
    p, doubted = (
        conservative_probability(*said, np.array([known]), margin)[0] for known in (True, False)
    )
    assert doubted <= ALMOST_CERTAINLY_SAFE_P * min(most, least, expit(low - margin))
    assert doubted <= p <= min(most, 1.0 - MAX_CLAIM_DEFICIT)
    # In the domain what is not surely safe is as much in doubt as beyond.
    assert p == doubted or p >= ALMOST_CERTAINLY_SAFE_P
    # Worse evidence, of any kind, is told no better, over both edges.
    for worse in ((low - 0.3, most, least), (low, 0.9 * most, least), (low, most, 0.9 * least)):
        said = [np.array([v]) for v in worse]
        q, beyond = (
            conservative_probability(*said, np.array([known]), margin)[0] for known in (True, False)
        )
        assert max(q, beyond) <= p
        assert beyond <= doubted


def test_the_floor_is_what_a_world_of_750_sites_may_hide():
    # One site of 250 unsafe: none of 750 shows it in one case of twenty.
    hidden = (1.0 - MAX_CLAIM_DEFICIT) ** 750
    assert hidden == pytest.approx(0.05, abs=0.001)
    # Odds of being unsafe: doubled where claimed, twelve times near the domain of the packaged fit.
    even = LogOddsBounds(np.zeros(1), np.zeros(1)).estimate(np.ones(1)).p
    assert even == pytest.approx((1.0 - MAX_CLAIM_DEFICIT) / 3.0)
    near = conservative_probability(
        np.zeros(1), np.ones(1), np.ones(1), np.zeros(1, bool), GAUSSIAN_DEM.outside_margin
    )
    assert near == pytest.approx(ALMOST_CERTAINLY_SAFE_P * (1.0 - MAX_CLAIM_DEFICIT) / 13.0)


def test_what_one_world_decides_is_not_agreed_on():
    """Two worlds say the same of the first feature; of the second one of them alone knows."""
    rng = np.random.default_rng(2)
    n = 6000
    one = rng.random(n) < 0.5
    x = np.column_stack((np.ones(n), rng.random(n), np.where(one, rng.random(n), 0.0)))
    law = -4.0 + 9.0 * x[:, 1] + 3.0 * x[:, 2]
    worlds = {"one": one, "other": ~one, "never seen": np.zeros(n, bool)}
    safe = rng.random(n) < expit(law)
    model = Ensemble.fit(x, safe, worlds, "here", rising=2)
    assert model.without == ("one", "other")
    assert model.note == "here"
    assert min(w for row in model.weights for w in row[1:]) >= 0.0
    sites = np.array([[1.0, 0.9, 0.0], [1.0, 0.5, 0.9]])
    odds = model.evaluate_features(sites)
    assert odds.estimate(np.ones(2)).agreed.tolist() == [True, False]
    whole = sites @ np.array(model.weights[0])
    assert whole == pytest.approx(sites @ [-4.0, 9.0, 3.0], abs=0.4)
    assert (odds.low <= whole).all()
    # Where the steps begin is not where they end.
    again = Ensemble.fit(x, safe, worlds, "here", rising=2, start=model)
    assert np.array(again.weights) == pytest.approx(np.array(model.weights), abs=1e-3)
    # Each fit is that without its world.
    alone = Logistic.fit(x[~one], safe[~one], rising=2)
    assert np.array(model.weights[1]) == pytest.approx(alone.weights, abs=1e-3)


def test_files_are_checked(tmp_path):
    model = QUADTREE.packaged
    model.save(tmp_path / "m.json")
    assert Ensemble.load(tmp_path / "m.json", QUADTREE.count) == model
    assert Ensemble.load(tmp_path / "m.json", QUADTREE.count).digest == model.digest
    row = [0.0] * QUADTREE.count
    for wrong in (
        "", "{}", "[]", "1", '{"weights": [1, 2]}', '{"weights": "x"}', '{"weights": []}',
        *(file_of(row, [*row[1:], w]) for w in ("a", float("nan"), 1e308, True, -0.1)),
        file_of(row, row[1:]), file_of(row), file_of(row, row, without="a"),
        file_of(row, row, without=[]),
    ):  # fmt: skip
        (tmp_path / "bad.json").write_text(wrong)
        with pytest.raises(InputError, match="calibration"):
            Ensemble.load(tmp_path / "bad.json", QUADTREE.count, QUADTREE.monotone_count)
    (tmp_path / "bad.json").write_bytes(b"\xff\xfe\x00")
    for name in ("bad.json", "missing.json"):
        with pytest.raises(InputError, match="calibration"):
            Ensemble.load(tmp_path / name, QUADTREE.count)
    (tmp_path / "good.json").write_text(file_of(row, row))
    Ensemble.load(tmp_path / "good.json", QUADTREE.count, QUADTREE.monotone_count)


def file_of(*weights, without=None):
    """Return the text of a file of fits, those but the first without a world each."""
    named = [f"world {n}" for n in range(len(weights) - 1)] if without is None else without
    return json.dumps({"weights": weights, "without": named})
