"""The last stage of a scenario: sound whatever it is, and refused where it does not belong."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety, site_probability
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    MAX_CLAIM_DEFICIT,
)
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.calibration.ensemble import Ensemble
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM, UNKNOWN_MODEL_WEIGHT
from lunarsim.onboard.calibration.scenario_calibration import (
    ScenarioCalibration,
    lander_safety_params,
)
from lunarsim.onboard.calibration.stage import CalibrationStage
from tests.map_evidence import LANDER, evidence, rocky

PACKAGED = GAUSSIAN_DEM.packaged
WIDE = CalibrationDomain(0.5, 1e6, (0.0, 1.0), (0.0, 1.0))


def refit(inside=(0.3, 0.8), outside=(-0.5, 0.6), domain=WIDE, **more) -> ScenarioCalibration:
    figures = {
        "inside": CalibrationStage(*inside),
        "outside": CalibrationStage(*outside),
        "domain": domain,
    }
    figures |= {"lander": lander_safety_params(LANDER), "regression": PACKAGED.digest}
    return ScenarioCalibration(**figures | more)


stages = st.tuples(st.floats(-4.0, 4.0), st.floats(0.0, 3.0))
domains = st.builds(
    lambda h, t, n, s: CalibrationDomain(h, t, (0.0, n), (0.0, s)),
    st.floats(1e-3, 1.0), st.floats(1e-2, 1e3), st.floats(0.02, 1.0), st.floats(0.02, 1.0),
)  # fmt: skip


@given(
    stages,
    stages,
    domains,
    st.floats(0.0, 1.6),
    st.floats(0.0, 1.6),
    st.floats(0.02, 30.0),
    st.floats(2.0, 200.0),
    st.floats(0.0, 0.5),
)
def test_worse_terrain_is_never_called_safer(
    inside, outside, domain, slope, rough, times, density, worse
):
    """Whatever a fit finds, in either domain, outside, and across their edges."""
    one = refit(inside, outside, domain)
    here = {"slope": slope, "rough": rough, "density": density, "curve": rocky(times)}
    p, _ = calibrated_safety(evidence(**here), refit=one)
    most = p.max() + 1e-5
    for change in (
        {"slope": slope + worse},
        {"rough": rough + worse},
        {"curve": rocky(times * (1.0 + 3.0 * worse))},
        {"curve": rocky(times * (1.0 + 100.0 * worse))},
        {"level": 1.0 - 5.0 * worse},
        {"planes": 2.0 - 5.0 * worse},
    ):
        q, _ = calibrated_safety(evidence(**here | change), refit=one)
        assert (q <= most).all(), change


def test_each_side_of_the_packaged_domain_has_its_stage():
    near, far = evidence(slope=0.2), evidence(slope=0.2, density=3.0)
    assert near.in_domain.all()
    assert not far.in_domain.any()
    for e, stages_of in ((near, ((0.3, 0.8),)), (far, ((0.3, 0.8), (-0.5, 0.6)))):
        z = (e.features(e.observed) @ np.array(PACKAGED.weights).T).min(axis=1)
        z = z.reshape(e.horizontal_plane.grid.shape)
        p, known = calibrated_safety(e, refit=refit())
        assert known.all()
        expected = np.min([expit(a + b * z) for a, b in stages_of], axis=0)
        assert (expected < e.observed_terrain_bound()).all()
        assert p == pytest.approx(expected, rel=1e-5)
    # The lower of both outside, whichever that is.
    p, _ = calibrated_safety(far, refit=refit(outside=(3.0, 1.0)))
    assert p == pytest.approx(expit(0.3 + 0.8 * z), rel=1e-5)


def test_outside_the_domain_of_the_fit_it_is_a_bound():
    e = evidence(slope=0.1, rough=0.1, level=3.0, planes=6.0, density=3.0)
    plain, _ = calibrated_safety(e)
    for narrow in (
        replace(WIDE, hazards=1e-3), replace(WIDE, tilting=1e-9), replace(WIDE, noise=(0.5, 1.0)),
        replace(WIDE, noise=(0.0, 0.01)), replace(WIDE, spacing=(0.5, 1.0)),
        replace(WIDE, spacing=(0.0, 0.01)),
    ):  # fmt: skip
        p, known = calibrated_safety(e, refit=refit((3.0, 1.0), (3.0, 1.0), narrow))
        assert not known.any(), narrow
        assert (p <= e.outside_domain_bound() + 1e-6).all()
        assert (p <= plain + 1e-6).all()
        # Never above what it says where it knows.
        low, _ = calibrated_safety(e, refit=refit((-40.0, 1.0), (3.0, 1.0), narrow))
        assert (low < 0.01).all()


def test_its_domain_is_its_own_whether_the_fits_agree_or_not():
    rows = np.zeros((2, GAUSSIAN_DEM.count))
    rows[:, 0] = 1.0, 2.0
    apart = Ensemble(tuple(map(tuple, rows)))
    e = evidence(slope=0.1, rough=0.1, level=6.0, planes=6.0)
    assert not calibrated_safety(e, apart)[1].any()
    p, known = calibrated_safety(e, apart, refit(regression=apart.digest))
    assert known.all()
    # The lowest of the fits is what it stretches.
    assert p == pytest.approx(expit(0.3 + 0.8 * 1.0), rel=1e-5)
    # Outside of it the plain regression is a bound too, lower here than all else.
    low = Ensemble((tuple(-9.0 * (rows[0] > 0.0)),) * 2)
    narrow = replace(WIDE, noise=(0.5, 1.0))
    p, known = calibrated_safety(e, low, refit((20.0, 1.0), domain=narrow, regression=low.digest))
    assert not known.any()
    bounded = (1.0 - MAX_CLAIM_DEFICIT) * expit(-9.0 - GAUSSIAN_DEM.outside_margin)
    assert p == pytest.approx(
        ALMOST_CERTAINLY_SAFE_P
        * ((1.0 - UNKNOWN_MODEL_WEIGHT) * bounded + UNKNOWN_MODEL_WEIGHT * expit(-9.0)),
        rel=1e-4,
    )


def test_the_ceiling_holds_after_it():
    p, _ = calibrated_safety(evidence(planes=-3.0), refit=refit((9.0, 0.1), (9.0, 0.1)))
    assert (p <= 4.0 * 0.00136).all()
    assert (p > 0.0).all()


def test_in_its_domain_rocks_under_the_pads_are_what_its_sites_were():
    e = evidence(slope=0.9, rough=0.1, level=6.0, planes=6.0, density=3.0)
    assert (e.p_no_rock_under_pads() < 0.1).all()
    own = refit((3.0, 1.0), (-0.2, 0.3))
    p, known = calibrated_safety(e, refit=own)
    assert known.all()
    assert (p > 5.0 * e.p_no_rock_under_pads()).all()
    # Outside of it nobody knows: the chance that there is none holds, in all cases but a few.
    narrow = replace(
        own, domain=replace(WIDE, tilting=0.5 * float(e.expected_tilt_violations.min()))
    )
    q, known = calibrated_safety(e, refit=narrow)
    assert not known.any()
    assert (q <= e.p_no_rock_under_pads() + UNKNOWN_MODEL_WEIGHT).all()


def test_worse_evidence_beyond_its_domain_is_reported_no_better_however_low_it_is():
    own = refit((-9.0, 1.0), (-9.0, 1.0))
    for beyond in (-0.1, -2.0, -8.0):
        odds, one = np.array([0.0, beyond]), np.ones(2)
        inside = np.array([True, False])
        p = site_probability(GAUSSIAN_DEM, odds, one, one, np.zeros(2), inside, inside, own)
        assert 0.0 < p[1] <= p[0]


def sites(n=4000, inside=(0.5, 0.7), outside=(-0.6, 0.4), seed=1):
    rng = np.random.default_rng(seed)
    z, known = rng.normal(0.0, 3.0, n), rng.random(n) < 0.5
    p = np.where(known, expit(inside[0] + inside[1] * z), expit(outside[0] + outside[1] * z))
    return z, rng.random(n) < p, known


def test_a_fit_finds_both_stages():
    z, safe, known = sites()
    found = ScenarioCalibration.fit(z, safe, known, WIDE, LANDER, PACKAGED)
    assert (found.inside.intercept, found.inside.slope) == pytest.approx((0.5, 0.7), abs=0.12)
    assert (found.outside.intercept, found.outside.slope) == pytest.approx((-0.6, 0.4), abs=0.12)
    # Sites on the wrong side of the odds do not turn the stage round.
    found = ScenarioCalibration.fit(-z, safe, known, WIDE, LANDER, PACKAGED)
    assert found.inside.slope == found.outside.slope == 0.0


def test_a_side_with_too_few_sites_is_left_as_it_is():
    z, safe, known = sites()
    few = known & (np.cumsum(known & ~safe) <= 15)
    found = ScenarioCalibration.fit(
        z[few | ~known],
        safe[few | ~known],
        known[few | ~known],
        WIDE,
        LANDER,
        PACKAGED,
    )
    assert found.inside == CalibrationStage(0.0, 1.0)
    assert found.outside != found.inside
    only = ScenarioCalibration.fit(z[known], safe[known], known[known], WIDE, LANDER, PACKAGED)
    assert only.outside == only.inside != CalibrationStage(0.0, 1.0)
    with pytest.raises(InputError, match="20 or more safe"):
        ScenarioCalibration.fit(z[safe], safe[safe], known[safe], WIDE, LANDER, PACKAGED)


def test_the_domain_is_that_of_nearly_all_sites():
    hazards, tilting = np.linspace(0.0, 1.0, 1001), np.linspace(0.0, 100.0, 1001)
    domain = CalibrationDomain.of(hazards, tilting, [0.05, 0.1], [0.2, 0.3])
    assert (domain.hazards, domain.tilting) == pytest.approx((0.99, 99.0))
    assert domain.noise == pytest.approx((0.04, 0.125))
    assert domain.spacing == pytest.approx((0.16, 0.375))
    assert list(domain.is_within_counts([0.98, 1.0, 0.0, np.nan], [0.0, 0.0, 99.5, 0.0])) == [
        True
    ] + 3 * [False]
    for name, value in (("hazards", np.nan), ("tilting", -1.0), ("noise", (0.2, 0.1)),
                        ("spacing", (0.0, np.inf))):  # fmt: skip
        with pytest.raises(InputError, match=rf"domain\.{name}"):
            replace(domain, **{name: value})


# --- whom it belongs to -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "key", "right"),
    [
        ({"legs": 3}, "legs", "4"),
        ({"leg_radius": 2.0}, "leg_radius_m", "2.35"),
        ({"pad_diameter": 0.4}, "pad_diameter_m", "0.3"),
        ({"slope_limit": np.deg2rad(12.0)}, "slope_limit_deg", "10"),
        ({"roughness_limit": 0.3}, "roughness_limit_m", "0.25"),
    ],
)
def test_another_lander_is_refused(change, key, right):
    e = evidence()
    other = replace(e, lander=replace(LANDER, **change))
    with pytest.raises(InputError, match=rf"vehicle\.{key}: must be {right}, as in"):
        calibrated_safety(other, refit=refit())
    # What safety does not depend on may differ.
    calibrated_safety(replace(e, lander=replace(LANDER, dry_mass=900.0)), refit=refit())


def test_another_regression_is_refused():
    *weights, last = PACKAGED.weights
    other = Ensemble((*weights, (*last[:-1], last[-1] + 1e-9)))
    assert other.digest != PACKAGED.digest
    with pytest.raises(InputError, match=r"calibration\.regression"):
        calibrated_safety(evidence(), other, refit())


# --- files --------------------------------------------------------------------------------------


def test_what_is_saved_is_loaded(tmp_path):
    figures = {"packaged_domain": {"ece": 0.1, "skill": None}}
    one = refit(
        scenario="mine", mapper="dem", flights=12, sites=7200, seed=3, before=figures, after=figures
    )
    one.save(tmp_path / "c.json")
    assert ScenarioCalibration.load(tmp_path / "c.json") == one
    assert [p.name for p in tmp_path.iterdir()] == ["c.json"]


def interrupted(*_):
    raise KeyboardInterrupt


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "c.json"
    path.write_text("old")
    with pytest.raises(ValueError, match="JSON"):
        refit(before={"x": {"ece": np.nan}}).save(path)
    assert path.read_text() == "old"
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "replace", interrupted)
        refit().save(path)
    assert path.read_text() == "old"
    (tmp_path / "d.json").mkdir()
    with pytest.raises(OSError, match=r"d\.json"):
        refit().save(tmp_path / "d.json")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.json", "d.json"]


GONE = object()


@pytest.mark.parametrize(
    ("keys", "value", "says"),
    [
        (("inside", "slope"), -0.1, r"calibration\.slope.*0 or more"),
        (("outside", "slope"), float("nan"), r"calibration\.slope.*finite"),
        (("inside", "intercept"), "1", r"calibration\.intercept.*finite"),
        (("inside", "intercept"), 10**400, r"calibration\.intercept.*finite"),
        (("inside", "intercept"), True, r"calibration\.intercept.*finite"),
        (("outside",), GONE, "outside"),
        (("outside",), [1.0], r"calibration\.outside.*table"),
        (("domain", "hazards"), GONE, "hazards"),
        (("domain", "hazards"), -1.0, r"domain\.hazards"),
        (("domain", "noise"), [0.1], r"calibration\.noise"),
        (("domain", "spacing"), [0.1, float("inf")], r"calibration\.spacing"),
        (("lander", "leg_radius_m"), GONE, "leg_radius_m"),
        (("regression",), 5, r"calibration\.regression.*text"),
        (("flights",), 1.5, r"calibration\.flights.*integer"),
        (("before",), {"x": 1.0}, r"calibration\.x.*table"),
        (("format",), "other", "format"),
    ],
)
def test_other_files_are_refused(tmp_path, keys, value, says):
    path = tmp_path / "c.json"
    refit().save(path)
    data = json.loads(path.read_text())
    at = data
    for key in keys[:-1]:
        at = at[key]
    if value is GONE:
        del at[keys[-1]]
    else:
        at[keys[-1]] = value
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=says):
        ScenarioCalibration.load(path)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"weights": [1.0]}', b"\xff\xfe"])
def test_no_such_file(tmp_path, text):
    with pytest.raises(InputError, match=r"lunarsim calibrate.*none\.json"):
        ScenarioCalibration.load(tmp_path / "none.json")
    path = tmp_path / "c.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=r"lunarsim calibrate.*c\.json"):
        ScenarioCalibration.load(path)


def test_figures_are_those_of_the_scenario_file():
    assert lander_safety_params(Lander()) == {
        "legs": 4, "leg_radius_m": 2.35, "pad_diameter_m": 0.3, "slope_limit_deg": 10.0,
        "roughness_limit_m": 0.25,
    }  # fmt: skip
