"""Test the fused map: one sensor gives its own map, worse evidence is never safer."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    ALMOST_CERTAINLY_UNSAFE_P,
)
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM
from lunarsim.onboard.calibration.scenario_calibration import (
    ScenarioCalibration,
    lander_safety_params,
)
from lunarsim.onboard.calibration.stage import CalibrationStage
from lunarsim.onboard.hazards.fusion.flat_terrain import is_detection_count_plausible
from lunarsim.onboard.hazards.fusion.fuse import footprint_undetected_ratio, fuse_evidence
from lunarsim.onboard.hazards.fusion.registration import register_tracks
from lunarsim.onboard.hazards.fusion.resampling import resample_to_grid
from lunarsim.onboard.hazards.fusion.rock_existence import (
    COMMON_MISS_PROBABILITY,
    existence_given_elevations,
)
from lunarsim.onboard.hazards.fusion.rock_heights import (
    estimate_rock_heights,
    rock_free_probability,
)
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.map_evidence import TerrainEvidence
from tests.camera_and_lidar import (
    DIAMETERS,
    DOUBTED,
    FOOTPRINT,
    GRID,
    SAMPLED,
    TERMS,
    clear,
    eyes,
    raster,
    relief,
    samples,
    tracks,
)
from tests.map_evidence import LANDER, SIDE, evidence, rocky
from tests.reference import fusion as plain

# --- one sensor, or one without observations ---------------------------------------------------


@pytest.mark.parametrize("density", [2.0, 30.0])
def test_a_map_of_elevations_alone_is_its_own_or_that_of_flat_terrain_if_that_is_more(density):
    rough = np.full(GRID.shape, 0.2)
    rough[:4] = 0.9
    own = relief(rough=rough, **DOUBTED | {"density": density, "curve": rocky(0.1)})
    alone = fuse_evidence(own, None, TERMS)
    level = [
        [plain.flat_terrain(0.5, share, unseen, 1.0, 1.0, 0.9) for share, unseen in pairs]
        for pairs in map(zip, rough, own.site_evidence.expected_hazards)
    ]
    assert alone.p_safe == pytest.approx(np.maximum(own.hazard_map.p_safe, level), rel=1e-5)
    raised = alone.p_safe > own.hazard_map.p_safe
    assert raised.any()
    assert np.array_equal(alone.in_domain, own.hazard_map.in_domain & ~raised)
    # A rock sensor without observations changes nothing.
    blind = fuse_evidence(own, eyes(seen=False), TERMS)
    for name in ("p_safe", "observed", "in_domain"):
        assert np.array_equal(getattr(blind, name), getattr(alone, name)), name


def test_an_elevation_map_without_site_evidence_is_unchanged():
    own = replace(relief(rough=0.2), site_evidence=None)
    blind = fuse_evidence(own, eyes(seen=False), TERMS)
    for name in ("p_safe", "observed", "in_domain"):
        assert np.array_equal(getattr(blind, name), getattr(own.hazard_map, name)), name
    assert fuse_evidence(own, None, TERMS) is own.hazard_map


@pytest.mark.parametrize("has_evidence", [True, False])
def test_what_a_calibration_of_its_own_claims_stays_where_the_other_sensor_saw_nothing(
    has_evidence,
):
    refit = ScenarioCalibration(
        CalibrationStage(-3.0), CalibrationStage(-3.0),
        CalibrationDomain(10.0, 10.0, (0.0, 0.5), (0.01, 1.0)),
        lander_safety_params(LANDER), GAUSSIAN_DEM.packaged.digest,
    )  # fmt: skip
    site_evidence = evidence(slope=0.9, rough=0.9, density=5.0)
    p, known = calibrated_safety(site_evidence, refit=refit)
    assert known.all()
    assert ((p > ALMOST_CERTAINLY_UNSAFE_P) & (p < ALMOST_CERTAINLY_SAFE_P)).any()
    drawn = HazardMap(GRID, p, site_evidence.observed, SAMPLED, in_domain=known)
    own = TerrainEvidence(drawn, site_evidence if has_evidence else None, refit, SAMPLED)
    blind = fuse_evidence(own, eyes(seen=False), TERMS)
    assert np.array_equal(blind.p_safe, p)
    assert np.array_equal(blind.in_domain, known)
    # No calibrated probability is claimed where a rock is tracked.
    rock = fuse_evidence(own, eyes(1.0, tracks((0.0, 0.0, 0.4, 0.3)), seen=False), TERMS)
    assert not rock.in_domain[0, 0]


def test_a_map_of_rocks_alone_is_its_own_times_what_is_expected_of_the_terrain():
    own = eyes(0.1, tracks((2.0, 2.0, 0.4, 0.9)))
    alone = fuse_evidence(None, own, TERMS)
    assert np.array_equal(alone.p_safe, np.float32(0.9) * own.hazard_map.p_safe)
    assert alone.observed.all()
    assert not alone.in_domain.any()
    with pytest.raises(InputError, match="elevations, rocks: must not both"):
        fuse_evidence(None, None, TERMS)
    for prior in (1.0, -0.1, np.nan):
        with pytest.raises(InputError, match="terrain_prior"):
            replace(TERMS, terrain_prior=prior)


def test_a_map_without_evidence_is_only_multiplied():
    own = replace(relief(), site_evidence=None)
    both = fuse_evidence(own, eyes(0.1, tracks((2.0, 2.0, 0.4, 0.5))), TERMS)
    assert both.p_safe == pytest.approx(0.5 * own.hazard_map.p_safe, rel=1e-6)


# --- two sensors -------------------------------------------------------------------------------


def test_lit_terrain_makes_sites_safer_and_dark_terrain_less_safe():
    own = relief(rough=0.1, density=5.0, curve=rocky(16.0))
    p = [
        fuse_evidence(own, eyes(r), TERMS).p_safe[4, 4]
        for r in (20.0, 1.0, 0.3, COMMON_MISS_PROBABILITY, 0.0)
    ]
    assert p[0] < p[1] < p[2] < p[3]
    # Both sensors miss some rocks for a common reason.
    assert p[4] == p[3]


def test_the_map_is_the_thinned_one_times_the_rocks_that_are_tracked():
    own = relief(rough=0.2, density=3.0, curve=rocky(2.0))
    rng = np.random.default_rng(3)
    ratio = rng.uniform(0.05, 2.0, GRID.shape)
    known = tracks((0.1, 0.2, 0.4, 0.7), (4.0, 3.9, 0.3, 0.2))
    both = fuse_evidence(own, eyes(ratio, known), TERMS)
    thinned = replace(
        own.site_evidence,
        undetected_rock_ratio=footprint_undetected_ratio(eyes(ratio), GRID, TERMS),
    )
    p, _ = calibrated_safety(thinned)
    for row, col in product(range(SIDE), repeat=2):
        x, y = GRID.centre_of(row, col)
        expected = p[row, col]
        for (east, north), r, there in zip(known.xy, known.radius, known.existence, strict=True):
            if np.hypot(x - east, y - north) < FOOTPRINT + r:
                expected *= 1.0 - there
        assert both.p_safe[row, col] == pytest.approx(expected, rel=1e-5)


def test_with_samples_rocks_count_as_high_as_both_sensors_estimate():
    own = replace(relief(rough=0.2, density=3.0, curve=rocky(2.0)), residual_heights=SAMPLED)
    known = tracks((0.1, 0.2, 0.4, 0.7), (4.0, 3.9, 0.3, 0.2))
    both = fuse_evidence(own, eyes(0.3, known), TERMS)
    thinned = replace(
        own.site_evidence, undetected_rock_ratio=footprint_undetected_ratio(eyes(0.3), GRID, TERMS)
    )
    p, _ = calibrated_safety(thinned)
    heights = estimate_rock_heights(known, samples(own), LANDER)
    expected = p * rock_free_probability(known, heights, GRID, LANDER)
    assert both.p_safe == pytest.approx(expected, rel=1e-5)
    assert (expected < 0.99 * p).any()


@given(
    st.floats(0.0, 0.5), st.floats(0.15, 0.6), st.floats(1.0, 60.0), st.floats(0.0, 0.4),
    st.floats(0.0, 1.0),
)  # fmt: skip
def test_worse_evidence_of_rocks_and_samples_never_makes_a_site_safer(
    there, radius, density, top, worse
):
    def p(e=there, d=density, t=top):
        own = relief(rough=0.2)
        judged = replace(own.site_evidence, density=np.full(GRID.shape, d))
        own = replace(
            own, site_evidence=judged, residual_heights=np.full(GRID.shape, t, np.float32)
        )
        return fuse_evidence(own, eyes(0.3, tracks((2.0, 2.0, radius, e))), TERMS).p_safe

    before = p()
    assert (p(e=there + worse * (0.5 - there)) <= before + 1e-6).all()
    assert (p(d=density / (1.0 + worse)) <= before + 1e-6).all()
    assert (p(t=top + worse) <= before + 1e-6).all()


@pytest.mark.parametrize(
    ("slope", "rough"), [(0.5, 0.2), (0.9, 0.2), (0.2, 0.65), (0.85, 0.9), (1.1, 0.0), (0.2, 1.0)]
)
@pytest.mark.parametrize("rocks", [20.0, 0.05])
def test_terrain_that_is_level_and_clear_is_no_less_safe_than_that(slope, rough, rocks):
    own = relief(slope=slope, rough=rough, **DOUBTED | {"curve": rocky(rocks)})
    own = replace(own, residual_heights=SAMPLED)
    rock = tracks((0.1, 0.2, 0.5, 0.7))
    told = eyes(0.5, rock, undetected_probability=raster(0.2))
    judged = replace(
        own.site_evidence, undetected_rock_ratio=footprint_undetected_ratio(told, GRID, TERMS)
    )
    heights = estimate_rock_heights(rock, samples(own), LANDER)
    clear = rock_free_probability(rock, heights, GRID, LANDER)
    p = calibrated_safety(judged)[0] * clear
    # Where the camera has no observation, or is rejected, only the expectation from samples counts.
    blind = replace(told, hazard_map=replace(told.hazard_map, observed=np.zeros(GRID.shape, bool)))
    raised = 0
    for eye, missed in (
        (told, 0.2),
        (replace(told, undetected_probability=None), 1.0),
        (blind, 1.0),
    ):
        both = fuse_evidence(own, eye, TERMS)
        level = np.array([
            [plain.flat_terrain(slope, rough, unseen, missed, c, 0.9) for unseen, c in cells]
            for cells in map(zip, judged.expected_hazards, clear)
        ])  # fmt: skip
        assert both.p_safe == pytest.approx(np.maximum(level, p), rel=1e-5, abs=1e-9)
        assert not both.in_domain[level > p * (1.0 + 1e-5)].any()
        raised += np.count_nonzero(level > 1.01 * p)
    assert bool(raised) == (max(slope, rough) < 1.0)


def test_where_nothing_is_thinned_out_the_elevations_count_as_they_are_bit_for_bit():
    own = relief(rough=0.2, density=3.0, curve=rocky(8.0))
    left = np.arange(SIDE) == 0
    ratio = np.where(left, np.float32(0.01), np.float32(1.0)) * np.ones((2, *GRID.shape))
    rocks = eyes(ratio)
    touched = footprint_undetected_ratio(rocks, GRID, TERMS).is_changed & own.hazard_map.observed
    assert touched.any() and (own.hazard_map.observed & ~touched).any()
    both = fuse_evidence(own, rocks, TERMS)
    rest = own.hazard_map.observed & ~touched
    assert np.array_equal(both.p_safe[rest], own.hazard_map.p_safe[rest])
    assert (both.p_safe[touched] > own.hazard_map.p_safe[touched]).any()
    # The map of the elevations is not computed.
    asked = replace(own, compute_map=lambda: pytest.fail("judged"))
    assert np.array_equal(fuse_evidence(asked, rocks, TERMS).p_safe, both.p_safe)


def test_a_sensor_that_finds_far_too_few_rocks_is_not_believed():
    own = replace(relief(**DOUBTED), residual_heights=SAMPLED)
    unlikely = replace(eyes().hazard_map, in_domain=np.zeros(GRID.shape, bool))
    for radius, counts in ((0.2, False), (0.3, True)):
        rocks = tracks(*((0.3 * k, 3.9, radius, 0.9) for k in range(12)))
        found = replace(
            eyes(1.0, rocks, undetected_probability=raster(0.2), expected_detections=40.0),
            hazard_map=unlikely,
        )
        both, without = (
            fuse_evidence(own, e, TERMS)
            for e in (found, replace(found, undetected_probability=None))
        )
        assert (both.p_safe > without.p_safe).any() == counts, radius


def test_rocks_that_it_reads_too_small_count_by_the_heights_that_samples_have():
    rocks = tracks(*((0.3 * k, 2.0, 0.2, 0.9) for k in range(12)))
    for rise, known in ((0.0, False), (0.4, True)):
        own = relief(**DOUBTED)
        judged = replace(own.site_evidence, density=np.full(GRID.shape, 30.0))
        own = replace(own, site_evidence=judged, residual_heights=raster(rise))
        placed = register_tracks(rocks, samples(own), 1.2)
        heights = estimate_rock_heights(placed, samples(own), LANDER)
        found = replace(eyes(1.0, rocks, expected_detections=40.0))
        found = replace(
            found, hazard_map=replace(found.hazard_map, in_domain=np.zeros(GRID.shape, bool))
        )
        assert is_detection_count_plausible(found, placed, heights, LANDER.roughness_limit) == known


def test_no_frequency_is_claimed_where_what_both_have_seen_of_the_terrain_counts():
    own = relief(slope=0.5, rough=0.3, density=0.5, curve=rocky(20.0))
    low = replace(own.hazard_map, p_safe=raster(0.02), in_domain=np.ones(GRID.shape, bool))
    own = replace(own, surface=low, residual_heights=SAMPLED)
    both = fuse_evidence(own, eyes(1.0, undetected_probability=raster(0.2)), TERMS)
    assert both.p_safe == pytest.approx(0.72)
    assert not both.in_domain.any()
    assert fuse_evidence(own, eyes(1.0), TERMS).in_domain.all()
    # The same holds without the other sensor.
    few = replace(own, site_evidence=relief(slope=0.5, rough=0.3, density=300.0).site_evidence)
    alone = fuse_evidence(few, None, TERMS)
    assert (alone.p_safe > 0.8).all()
    assert not alone.in_domain.any()
    assert fuse_evidence(own, None, TERMS).in_domain.all()


@given(
    st.floats(0.0, 1.2), st.floats(0.0, 1.2), st.floats(0.0, 1.0), st.floats(0.0, 0.5),
    st.floats(0.0, 1.0),
)  # fmt: skip
def test_less_level_or_clear_terrain_is_never_safer(slope, rough, unseen, there, worse):
    here = {"slope": slope, "rough": rough, "unseen": unseen, "there": there}

    def p(**changes):
        e = here | changes
        own = replace(
            relief(slope=e["slope"], rough=e["rough"], **DOUBTED), residual_heights=SAMPLED
        )
        rock = tracks((2.0, 2.0, 0.4, e["there"]))
        return fuse_evidence(
            own, eyes(1.0, rock, undetected_probability=raster(e["unseen"])), TERMS
        ).p_safe

    before = p()
    for change in (
        {"slope": slope + worse}, {"rough": rough + worse},
        {"unseen": unseen + worse * (1.0 - unseen)}, {"there": there + worse * (0.5 - there)},
    ):  # fmt: skip
        assert (p(**change) <= before + 1e-6).all(), change


def test_what_is_left_under_a_footprint_is_the_mean_over_it():
    wide = Grid(0.0, 0.0, 0.5, 41, 41)
    ratio = np.ones(wide.shape)
    ratio[20, 20] = 31.0
    mean = footprint_undetected_ratio(eyes(ratio, of=wide), wide, TERMS).ratio
    xy = wide.centres()
    far = np.hypot(*np.moveaxis(xy - xy[20, 20], -1, 0))
    for n, diameter in enumerate(DIAMETERS):
        reach = FOOTPRINT + 0.5 * diameter
        cells = np.pi * reach**2 / 0.25
        inside, outside = far < reach - 0.5, far > reach + 0.5
        assert mean[n][inside] == pytest.approx(1.0 + 30.0 / cells, rel=0.02)
        assert (mean[n][outside] == 1.0).all()


def test_a_frequency_is_claimed_only_where_sites_are_surely_safe_or_surely_not():
    own = relief(slope=0.1, rough=0.1, density=300.0)
    assert own.hazard_map.in_domain.all()
    both = fuse_evidence(own, eyes(0.1, tracks((0.0, 0.0, 0.4, 0.3))), TERMS)
    near = clear(tracks((0.0, 0.0, 0.4, 0.3))) < 1.0
    assert near.any()
    assert not both.in_domain[near & (both.p_safe < ALMOST_CERTAINLY_SAFE_P)].any()
    assert both.in_domain[~near].all()
    bad = relief(slope=2.5, rough=3.0, level=-5.0, planes=-5.0, density=300.0)
    never = fuse_evidence(bad, eyes(0.1), TERMS)
    assert (never.p_safe <= ALMOST_CERTAINLY_UNSAFE_P).all()
    assert np.array_equal(never.in_domain, bad.hazard_map.in_domain)


@given(
    st.floats(0.0, 1.3), st.floats(0.0, 1.3), st.floats(1.0, 100.0), st.floats(0.3, 4.0),
    st.floats(0.05, 3.0), st.floats(0.0, 0.95), st.floats(0.15, 0.6), st.floats(0.0, 1.0),
)  # fmt: skip
def test_worse_evidence_of_either_sensor_never_makes_a_site_safer(
    slope, rough, density, rocks, ratio, there, radius, worse
):
    here = {
        "slope": slope, "rough": rough, "density": density, "rocks": rocks, "ratio": ratio,
        "there": there, "radius": radius,
    }  # fmt: skip

    def p(**changes):
        e = here | changes
        own = relief(
            slope=e["slope"], rough=e["rough"], density=e["density"], curve=rocky(e["rocks"])
        )
        known = tracks((2.0, 2.0, e["radius"], e["there"]))
        return fuse_evidence(own, eyes(e["ratio"], known), TERMS).p_safe.astype(np.float64)

    before = p()
    for change in (
        {"slope": slope + worse}, {"rough": rough + worse}, {"rocks": rocks * (1.0 + worse)},
        {"ratio": ratio + worse}, {"there": there + worse * (1.0 - there) * 0.99},
    ):  # fmt: skip
        assert (p(**change) <= before + 1e-6).all(), change


# --- rocks located in the elevations -----------------------------------------------------------

ROCK = (2.0, 2.0, 0.4, 0.8)


def test_a_rock_that_dense_elevations_do_not_show_is_less_likely_to_be_one():
    rocks = tracks(ROCK)
    level, thin = (
        existence_given_elevations(rocks, relief(density=d), LANDER)[0] for d in (100, 1e-6)
    )
    assert thin == pytest.approx(0.8, abs=1e-5)
    odds = COMMON_MISS_PROBABILITY * 0.8 / 0.2
    assert level == pytest.approx(odds / (1.0 + odds), rel=1e-3)


def test_a_rock_that_they_show_or_cannot_show_keeps_its_odds():
    bump = np.zeros(GRID.shape)
    bump[4, 4] = 0.6 * LANDER.roughness_limit
    assert existence_given_elevations(tracks(ROCK), relief(bump, density=100), LANDER)[0] == 0.8
    hole = np.zeros(GRID.shape)
    hole[4, 4] = np.nan
    assert existence_given_elevations(tracks(ROCK), relief(hole, density=100), LANDER)[0] == 0.8
    edge = tracks((0.0, 2.0, 0.4, 0.8))
    assert existence_given_elevations(edge, relief(density=100), LANDER)[0] == 0.8
    untold = replace(relief(density=100), site_evidence=None)
    assert existence_given_elevations(tracks(ROCK), untold, LANDER)[0] == 0.8


@given(
    st.integers(0, 10_000), st.floats(1.75, 2.25), st.floats(0.12, 0.4), st.floats(0.0, 0.99),
    st.floats(0.0, 0.3),
)  # fmt: skip
def test_odds_given_the_elevations_equal_a_plain_loop(seed, x, radius, there, rough):
    rng = np.random.default_rng(seed)
    z = rng.normal(0.0, rough, GRID.shape).astype(np.float32)
    density = rng.uniform(1.0, 30.0, GRID.shape)
    own = relief(z, density=density)
    found = existence_given_elevations(tracks((x, 2.1, radius, there)), own, LANDER)[0]
    # The window of seven metres covers the complete map: all terrain has one mean.
    half = 7
    rise = [
        [
            float(z[r, c]) - z[max(r - half, 0) : r + half + 1, max(c - half, 0) : c + half + 1]
            .astype(float).mean()
            for c in range(SIDE)
        ]
        for r in range(SIDE)
    ]  # fmt: skip
    cells = {(r, c): (0.5 * c, 0.5 * r) for r, c in product(range(SIDE), repeat=2)}
    told = own.site_evidence.density
    expected = plain.existence(
        (x, 2.1),
        0.05,
        radius,
        0.01,
        there,
        cells,
        rise,
        told,
        LANDER.roughness_limit,
        0.5,
        COMMON_MISS_PROBABILITY,
    )
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-12)


# --- other cells -------------------------------------------------------------------------------


def test_on_other_cells_the_worst_nearby_counts_and_nothing_beyond_the_edge():
    fine = Grid(0.0, 0.0, 0.25, 12, 12)
    coarse = Grid(0.1, 0.1, 0.6, 8, 8)
    layer = np.random.default_rng(1).random(fine.shape).astype(np.float32)
    assert resample_to_grid(layer, fine, fine, 0.0, "minimum") is layer
    for of, to, values in ((fine, coarse, layer), (coarse, fine, layer[:8, :8])):
        low = resample_to_grid(values, of, to, -1.0, "minimum")
        high = resample_to_grid(values, of, to, 9.0, "maximum")
        xy = to.centres()
        inside = of.contains(xy)
        assert inside.any()
        assert not inside.all() or of is coarse
        assert (low[~inside] == -1.0).all()
        assert (high[~inside] == 9.0).all()
        for row, col in np.argwhere(inside):
            # Every overlapping cell has at least, or at most, that value.
            off = np.abs(of.centres() - xy[row, col]).max(axis=-1)
            over = values[off < 0.5 * (of.posting + to.posting) - 1e-9]
            assert low[row, col] <= over.min()
            assert high[row, col] >= over.max()


def test_evidence_of_other_cells_than_the_map_is_refused():
    good = eyes()
    with pytest.raises(InputError, match=r"evidence\.undetected_ratio"):
        replace(good, undetected_ratio=good.undetected_ratio[:, :4])
    for unseen in (np.zeros((2, 2), np.float32), raster(1.01), raster(-0.01), raster(np.nan)):
        with pytest.raises(InputError, match=r"evidence\.undetected_probability"):
            replace(good, undetected_probability=unseen)
    with pytest.raises(InputError, match=r"rocks\.sigma"):
        replace(tracks(ROCK), sigma=np.zeros(2))
