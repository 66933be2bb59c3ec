"""The calibrated probability: sound by construction, and silent about what it cannot know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    LOG_ODDS_MARGIN,
    MAX_CLAIM_DEFICIT,
)
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.calibration.ensemble import Ensemble
from lunarsim.onboard.calibration.evidence import MAX_P_UNCOUNTED_ROCKS, UNCONSTRAINED_FEATURES
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM, UNKNOWN_MODEL_WEIGHT
from lunarsim.rocks.size_distribution import golombek_number
from lunarsim.safety.rock_effects import tilt_limit_rock_height
from lunarsim.safety.unseen_rocks import (
    ExceedanceCurve,
    depth_curve,
    distribution_fraction,
    height_curve,
)
from tests.map_evidence import LANDER, SIDE, evidence, rocky

weights = st.integers(0, 10_000).map(
    lambda seed: Ensemble(
        tuple(
            (
                *np.random.default_rng([seed, fit]).normal(0.0, 1.0, UNCONSTRAINED_FEATURES),
                *np.random.default_rng([seed, fit, 1]).exponential(
                    0.4, GAUSSIAN_DEM.count - UNCONSTRAINED_FEATURES
                ),
            )
            for fit in range(3)
        )
    )
)


@given(
    weights,
    st.floats(0.0, 1.6),
    st.floats(0.0, 1.6),
    st.floats(0.02, 30.0),
    st.floats(2.0, 200.0),
    st.floats(0.0, 0.5),
)
def test_worse_terrain_is_never_called_safer(model, slope, rough, times, density, worse):
    """Whatever weights a fit finds, in the domain, outside, and across its edge."""
    here = {"slope": slope, "rough": rough, "density": density, "curve": rocky(times)}
    p, _ = calibrated_safety(evidence(**here), model)
    # A noise of float32.
    most = p.max() + 1e-5
    for change in (
        {"slope": slope + worse},
        {"rough": rough + worse},
        {"curve": rocky(times * (1.0 + 3.0 * worse))},
        {"holes": rocky(times * (0.01 + worse))},
        {"level": 1.0 - 5.0 * worse},
        {"planes": 2.0 - 5.0 * worse},
    ):
        q, _ = calibrated_safety(evidence(**here | change), model)
        assert (q <= most).all(), change


@given(weights, st.integers(0, 10_000), st.floats(1.0, 3.0), st.floats(2.0, 200.0), st.floats(0, 1))
def test_terrain_with_taller_rocks_is_never_called_safer(model, seed, times, density, slope):
    """Some of the samples that met a rock, or fell into a hole, met a greater one."""
    rng = np.random.default_rng(seed)
    rises = np.zeros(int(rng.choice([300, 3000])))
    count = int(rng.integers(1, 60))
    rises[:count] = 0.25 * rng.uniform(0.3, 2.5, count) * rng.choice([-1.0, 1.0], count)
    worse = rises.copy()
    worse[: int(rng.integers(1, count + 1))] *= times

    def p_of(rises):
        said = (rises, 0.01, LANDER.roughness_limit, 0.05)
        curves = {"curve": height_curve(*said), "holes": depth_curve(*said)}
        return calibrated_safety(
            evidence(slope=slope, rough=0.2, density=density, **curves), model
        )[0]

    assert (p_of(worse) <= p_of(rises) + 1e-6).all()


def test_the_packaged_weights_do_not_fall_and_say_where_they_come_from():
    model = GAUSSIAN_DEM.packaged
    assert min(w for fit in model.weights for w in fit[UNCONSTRAINED_FEATURES:]) >= 0.0
    assert len(model.without) == len(model.weights) - 1 > 20
    assert "scenarios/lidar_maps/calibration.py" in model.note
    good, known = calibrated_safety(
        evidence(slope=0.05, rough=0.05, level=6.0, planes=6.0, curve=rocky(0.001))
    )
    assert known.all()
    assert (good > 0.98).all()
    bad, _ = calibrated_safety(evidence(slope=1.4, rough=1.5, level=-6.0, planes=-6.0))
    assert (bad < 0.01).all()


def test_outside_the_domain_it_is_a_bound_and_the_map_says_so():
    sparse = evidence(slope=0.1, rough=0.1, level=3.0, planes=6.0, density=0.01)
    assert (sparse.expected_hazards > 30.0 * GAUSSIAN_DEM.limits.hazards).all()
    p, known = calibrated_safety(sparse)
    assert not known.any()
    none = np.exp(-sparse.expected_roughness_violations)
    assert (sparse.outside_domain_bound() == np.minimum(sparse.horizontal_plane.p_safe, none)).all()
    assert (p <= np.minimum(sparse.horizontal_plane.p_safe, none) + 1e-6).all()
    # A noise or a spacing that no scan of the fit had.
    for odd in (replace(sparse, density=sparse.density * 100, noise=1.0),
                replace(sparse, density=sparse.density * 100, spacing=9.0)):  # fmt: skip
        assert not odd.in_domain.any()


def fits_of(*odds):
    """Return fits that say the same of all sites."""
    return Ensemble(tuple((o, *[0.0] * (GAUSSIAN_DEM.count - 1)) for o in odds))


def test_where_fits_differ_the_lowest_counts_and_is_no_frequency():
    e = evidence(slope=0.1, rough=0.1, level=6.0, planes=6.0, curve=rocky(0.01))
    assert e.in_domain.all()
    sure, doubtful = (
        (1.0 - MAX_CLAIM_DEFICIT) * expit(4.0 - LOG_ODDS_MARGIN),
        (1.0 - MAX_CLAIM_DEFICIT) * expit(2.0 - GAUSSIAN_DEM.outside_margin),
    )
    for odds, claims, wanted in (
        (
            (2.0, 5.0),
            False,
            ALMOST_CERTAINLY_SAFE_P
            * ((1.0 - UNKNOWN_MODEL_WEIGHT) * doubtful + UNKNOWN_MODEL_WEIGHT * expit(2.0)),
        ),
        ((4.0, 5.0), True, sure),
    ):
        p, known = calibrated_safety(e, fits_of(*odds))
        assert p == pytest.approx(wanted, rel=1e-5)
        assert (known == claims).all()


def test_uncertain_safety_is_reported_lower_and_at_most_the_bound_far_away():
    e = evidence(slope=0.1, rough=0.1, level=-1.0, planes=6.0, curve=rocky(0.01))
    far = evidence(slope=0.1, rough=0.1, level=-1.0, planes=6.0, density=0.01)
    assert (e.outside_domain_bound() == 1.0).all()
    assert (far.outside_domain_bound() < 0.1).all()
    for odds in (-1.0, 0.5, 3.5):
        for site in (e, far):
            p, known = calibrated_safety(site, fits_of(odds, odds))
            outside = np.minimum(
                (1.0 - MAX_CLAIM_DEFICIT) * expit(odds - GAUSSIAN_DEM.outside_margin),
                site.outside_domain_bound(),
            )
            bounded = np.min(
                [outside, site.observed_terrain_bound(), site.p_no_rock_under_pads()], axis=0
            )
            fits = np.minimum(expit(odds), site.observed_terrain_bound())
            wanted = ALMOST_CERTAINLY_SAFE_P * (
                (1.0 - UNKNOWN_MODEL_WEIGHT) * bounded + UNKNOWN_MODEL_WEIGHT * fits
            )
            assert p == pytest.approx(wanted, rel=1e-5)
            assert not known.any()
    # Surely unsafe is a frequency again.
    p, known = calibrated_safety(e, fits_of(-4.0, -3.5))
    assert (p < 0.02).all()
    assert known.all()


def test_among_sites_all_but_hopeless_the_best_is_reported():
    """Rocks by the thousand may stand unseen, so nothing is left; slopes are known all the same."""
    slope = np.repeat(np.linspace(0.1, 2.5, SIDE)[:, None], SIDE, axis=1)
    e = evidence(slope=slope, rough=0.1, level=-8.0, planes=1.0 - slope, density=1e-4)
    assert (e.outside_domain_bound() < 1e-12).all()
    p, known = calibrated_safety(e)
    assert not known.any()
    assert (p <= UNKNOWN_MODEL_WEIGHT).all()
    assert (np.diff(p[:, 0]) <= 0.0).all()
    assert p[0, 0] > 3.0 * p[-1, 0]


def test_what_was_seen_to_be_steep_is_left_no_chance_by_doubt():
    steep = evidence(slope=2.0, rough=0.1, level=-8.0, planes=-7.0, density=1e-4)
    p, _ = calibrated_safety(steep, fits_of(5.0, 5.0))
    assert (p <= UNKNOWN_MODEL_WEIGHT * steep.observed_terrain_bound()).all()
    assert (p > 0.0).all()


def test_the_domain_ends_where_samples_grow_sparse():
    density = np.repeat(np.geomspace(200.0, 0.5, SIDE)[:, None], SIDE, axis=1)
    known = evidence(slope=0.1, rough=0.1, density=density).in_domain
    assert known[0].all()
    assert not known[-1].any()
    assert (np.diff(known.astype(int), axis=0) <= 0).all()


def test_the_domain_ends_where_holes_may_gape_or_the_lander_is_another():
    good = {"slope": 0.1, "rough": 0.1, "curve": rocky(0.01)}
    assert evidence(**good).in_domain.all()
    assert not evidence(**good, holes=rocky(30.0)).in_domain.any()
    assert (
        evidence(**good, holes=rocky(30.0)).expected_hole_violations > GAUSSIAN_DEM.limits.holes
    ).all()
    for degrees, inside in ((3.0, False), (5.0, True), (20.0, True), (25.0, False)):
        other = replace(LANDER, slope_limit=np.deg2rad(degrees))
        e = replace(evidence(**good), lander=other)
        assert e.in_domain.all() == inside
        # A scenario's own has seen its own lander, and its own holes.
        domain = CalibrationDomain(1.0, 1.0, (0.0, 1.0), (0.0, 1.0))
        assert domain.contains(replace(evidence(**good, holes=rocky(30.0)), lander=other)).all()


def test_nothing_exceeds_what_the_planes_leave_of_slope_or_roughness():
    e = evidence(slope=0.1, rough=0.1, level=6.0, planes=6.0)
    for name in ("p_slope", "p_roughness"):
        some = np.full(e.horizontal_plane.grid.shape, 0.01, np.float32)
        doubtful = replace(e, support_planes=replace(e.support_planes, **{name: some}))
        assert doubtful.observed_terrain_bound() == pytest.approx(0.04, rel=1e-5)
        assert (calibrated_safety(doubtful)[0] <= 0.0401).all()


def test_just_under_the_limit_of_the_slope_nothing_is_surely_safe():
    good = {"rough": 0.05, "level": 6.0, "planes": 6.0, "curve": rocky(0.001)}
    probability = [
        calibrated_safety(evidence(**good, slope=s), fits_of(6.0))[0].max() for s in (0.8, 0.97)
    ]
    assert probability[0] > 0.99
    # All the rest says that it is safe; no rocks can be unseen.
    assert probability[1] <= 0.85 + 1e-6
    assert not calibrated_safety(evidence(**good, slope=0.97), fits_of(6.0))[1].any()


def test_on_a_slope_it_is_at_most_the_chance_that_no_unseen_rock_lies_under_a_pad():
    good = {"rough": 0.05, "level": 6.0, "planes": 6.0}
    expected = [1e-4, 0.01, 0.1]
    for tilting in expected:
        e = evidence(**good, slope=0.9)
        share = e.curve.share * tilting / e.expected_tilt_violations.max()
        e = replace(e, curve=ExceedanceCurve(e.curve.height, share))
        assert e.expected_tilt_violations == pytest.approx(tilting, rel=1e-6)
        p, claimed = calibrated_safety(e, fits_of(9.0))
        most = np.exp(-2.0 * tilting)
        assert p == pytest.approx(
            min(1.0 - MAX_CLAIM_DEFICIT, most)
            * (1.0 if most > ALMOST_CERTAINLY_SAFE_P else ALMOST_CERTAINLY_SAFE_P),
            abs=1e-3,
        )
        assert (claimed == (most > ALMOST_CERTAINLY_SAFE_P)).all()


def test_unobserved_terrain_is_not_safe():
    seen = np.zeros((SIDE, SIDE), bool)
    seen[1:3] = True
    p, known = calibrated_safety(evidence(seen=seen))
    assert (p[~seen] == 0.0).all()
    assert not known[~seen].any()


def test_evidence_that_does_not_belong_together_is_refused():
    e = evidence()
    other = Grid(1.0, 0.0, 0.5, SIDE, SIDE)
    for name, value in (
        ("noise", 0.0), ("noise", np.nan), ("spacing", np.inf), ("density", np.ones((2, 2))),
        ("support_planes", replace(e.support_planes, grid=other)),
        ("nominal", replace(e.nominal, grid=other)),
    ):  # fmt: skip
        with pytest.raises(InputError, match=rf"calibration\.{name}"):
            replace(e, **{name: value})


# --- rocks that no sample has met ---------------------------------------------------------------


def test_the_share_above_a_height_is_that_of_the_samples():
    rng = np.random.default_rng(1)
    # A twentieth of the ground 0.3 m high: any number of samples says so.
    rises = np.where(rng.random(20_000) < 0.05, 0.3, 0.0) + 0.005 * rng.standard_normal(20_000)
    curve = height_curve(rises, 0.005, 0.25, 0.05)
    assert curve.at([0.1, 0.2, 0.25]) == pytest.approx(0.05, rel=0.1)
    assert curve.at(0.5) < 0.05
    assert (np.diff(curve.share) <= 0.0).all()
    # None seen: the law, as sixty samples that say so, among all.
    empty = height_curve(np.zeros(5940), 0.005, 0.25, 0.05)
    assert empty.at(0.2) == pytest.approx(
        0.01 * distribution_fraction([0.2], 0.05, 0.5)[0], rel=0.05
    )


def test_noise_is_no_rock():
    rises = 0.1 * np.random.default_rng(2).standard_normal(10_000)
    noisy = height_curve(rises, 0.1, 0.25, 0.05).at(0.25)
    taken_for_ground = height_curve(rises, 0.01, 0.25, 0.05).at(0.25)
    assert noisy <= taken_for_ground + 1e-9
    assert noisy < 0.01


def test_few_high_rocks_say_nothing_of_rocks_too_low_to_be_counted():
    """Below what was counted there are no fewer than the law expects; above it is as counted."""
    height = 0.25 * np.geomspace(0.08, 8.0, 40)
    law = distribution_fraction(height, 0.05, 0.5)
    for noise, least in ((0.005, 0.05), (0.02, 0.075), (0.04, 0.15), (0.2, 0.25)):
        bare = height_curve(np.zeros(20_000), noise, 0.25, 0.05)
        assert bare.min_counted_gravel_height == pytest.approx(least)
        assert bare.min_counted_height == pytest.approx(max(least, 0.1))
        low = height < least
        assert (bare.share < 0.1 * law).all()
        assert bare.with_gravel.share[low] == pytest.approx(law[low])
        assert bare.with_gravel.share[~low] == pytest.approx(bare.share[~low])
    rises = np.zeros(20_000)
    rises[:4000] = 0.06
    gravel = height_curve(rises, 0.005, 0.25, 0.05)
    assert gravel.at(0.05) < 0.001  # nothing is higher than 0.1 m
    assert gravel.with_gravel.at(0.045) > 0.2
    assert gravel.with_gravel.at(0.1) == pytest.approx(gravel.at(0.1))


def test_where_rocks_too_low_to_be_counted_tilt_the_lander_no_site_is_surely_safe():
    good = {"rough": 0.05, "level": 6.0, "planes": 6.0}
    height = 0.25 * np.geomspace(0.08, 8.0, 40)
    for expected, most in ((0.0, MAX_P_UNCOUNTED_ROCKS), (1.0, 0.01)):
        gravel = 1e-9 + np.where(height < 0.1, 0.2 * expected, 0.0)
        curve = ExceedanceCurve(height, np.full(40, 1e-9), 0.1, gravel, 0.1)
        for slope, counts in ((0.7, True), (0.9, False)):
            e = replace(evidence(**good, slope=slope), curve=curve)
            assert (tilt_limit_rock_height(e.slope, e.lander) > 0.1).all() == counts
            p, claimed = calibrated_safety(e, fits_of(9.0))
            assert claimed.all() == counts and claimed.any() == counts
            assert (p > 0.99).all() if counts else (p <= most).all()


def test_higher_rocks_of_the_same_diameter_are_more_often_missed():
    curves = [height_curve(np.zeros(0), 0.01, 0.25, 0.05, ratio) for ratio in (0.5, 0.8)]
    assert [curve.rock_height_ratio for curve in curves] == [0.5, 0.8]
    flat, high = (curve.unseen_rocks(0.3, 20.0) / curve.at(0.3) for curve in curves)
    assert high > 10.0 * flat


@pytest.mark.parametrize("ratio", [0.5, 0.8])
def test_unseen_rocks_are_those_that_random_samples_miss(ratio):
    """Against throwing samples at discs 1.5 times as large as the base of a rock of this height."""
    curve = ExceedanceCurve(np.array([0.1, 0.4]), np.array([0.02, 0.02]), rock_height_ratio=ratio)
    rng = np.random.default_rng(3)
    height, density = 0.3, 2.0
    top = 1.5 * np.pi * (0.5 * height / ratio) ** 2
    count = rng.poisson(density * top, 200_000)
    expected = 0.02 / top * np.mean(count == 0)
    assert curve.unseen_rocks(height, density) == pytest.approx(expected, rel=0.02)
    assert curve.unseen_rocks(height, 2.0 * density) < curve.unseen_rocks(height, density)


def test_the_law_raises_as_much_terrain_as_its_rocks_do():
    h, cover = 0.2, 0.1
    wide = np.linspace(0.4, 6.0, 40_000)
    number = golombek_number(wide, cover)
    diameter = 0.5 * (wide[1:] + wide[:-1])
    area = 0.25 * np.pi * diameter**2 * (1.0 - (h / (0.5 * diameter)) ** 2)
    assert distribution_fraction([h], cover, 0.5)[0] == pytest.approx(
        float((area * -np.diff(number)).sum()), rel=0.02
    )
