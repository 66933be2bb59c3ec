"""Test the prior for terrain without a measured elevation."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.hazards.fusion.flat_terrain import no_undetected_rock_probability
from lunarsim.onboard.hazards.fusion.fuse import footprint_undetected_ratio, fuse_evidence
from lunarsim.onboard.hazards.fusion.priors import unobserved_safety_prior
from lunarsim.onboard.hazards.fusion.rock_heights import (
    estimate_rock_heights,
    rock_free_probability,
)
from tests.camera_and_lidar import (
    DOUBTED,
    FOOTPRINT,
    GRID,
    SAMPLED,
    TERMS,
    eyes,
    level_map,
    relief,
    samples,
    tracks,
)
from tests.map_evidence import LANDER, SIDE, evidence, rocky
from tests.reference import fusion as plain

# No elevation was measured beyond this column.
MEASURED = np.ones(GRID.shape, bool)
MEASURED[:, 6:] = False


def beside(cells, expected=0.9, posting=GRID.posting):
    """Return the prior of the reference from pairs (p, no undetected rock) of measured cells."""
    return plain.unobserved_safety_prior(list(cells), posting, FOOTPRINT, expected)


def thinned_by(own, rocks):
    """Return the site evidence of elevations after thinning by a rock sensor."""
    return replace(
        own.site_evidence, undetected_rock_ratio=footprint_undetected_ratio(rocks, GRID, TERMS)
    )


def test_without_elevations_the_other_sensor_counts_and_is_never_certain():
    own = relief(seen=MEASURED, rough=0.3, density=60.0, level=8.0, planes=8.0)
    both = fuse_evidence(own, eyes(0.1), TERMS)
    assert both.observed.all()
    free = np.exp(-10.0 * thinned_by(own, eyes(0.1)).expected_hazards)
    prior = beside(zip(both.p_safe[MEASURED].tolist(), free[MEASURED].tolist(), strict=True))
    assert 0.8999 < prior < 0.9
    assert both.p_safe[:, 6:] == pytest.approx(prior * 0.97)
    assert not both.in_domain[:, 6:].any()
    nothing = fuse_evidence(own, eyes(0.1, seen=False), TERMS)
    assert np.array_equal(nothing.observed, MEASURED)
    assert not nothing.p_safe[~MEASURED].any()


@pytest.mark.parametrize("steep", [0, 4, SIDE])
@pytest.mark.parametrize("what", ["slope", "rough"])
def test_terrain_that_was_not_measured_is_as_likely_fit_as_what_was(steep, what):
    share = np.full(GRID.shape, 0.4, np.float32)
    share[:steep] = 1.3
    own = relief(seen=MEASURED, **{what: share})
    both = fuse_evidence(own, eyes(0.1), TERMS)
    free = np.exp(-10.0 * thinned_by(own, eyes(0.1)).expected_hazards)
    prior = beside(zip(both.p_safe[MEASURED].tolist(), free[MEASURED].tolist(), strict=True))
    assert both.p_safe[:, 6:] == pytest.approx(prior * 0.97, rel=1e-5)


@pytest.mark.parametrize("found", [None, tracks((0.0, 2.0, 0.4, 0.9))])
def test_flat_terrain_counts_for_what_was_not_measured_and_tracked_rocks_do_not(found):
    density = np.full(GRID.shape, 0.5)
    density[:4] = 30.0
    level = {"slope": 0.5, "rough": 0.2} | DOUBTED | {"density": density}
    own = replace(relief(seen=MEASURED, **level), residual_heights=SAMPLED)
    missed = np.full(GRID.shape, 0.2, np.float32)
    told = eyes(0.1, found, undetected_probability=missed)
    both = fuse_evidence(own, told, TERMS)
    thinned = thinned_by(own, told)
    p, _ = calibrated_safety(thinned)
    flat = level_map(thinned, 0.9, 0.8)
    assert (flat > p)[MEASURED].all()
    free = np.maximum(np.exp(-10.0 * thinned.expected_hazards), 0.8)
    assert (free[MEASURED] == 0.8).any()
    assert (free[MEASURED] > 0.8).any()
    prior = beside(zip(flat[MEASURED].tolist(), free[MEASURED].tolist(), strict=True))
    assert both.p_safe[:, 8:] == pytest.approx(prior * 0.97, rel=1e-5)
    if found is not None:
        assert (both.p_safe < flat)[MEASURED].any()


@pytest.mark.parametrize("far", [1.2, 1.5, 2.0])
def test_samples_that_leave_all_terrain_in_doubt_do_not_make_it_safer_where_none_fell(far):
    slope, planes = np.full(GRID.shape, 2.0), np.full(GRID.shape, -3.0)
    slope[:4], planes[:4] = 0.3, 2.0
    own = relief(seen=MEASURED, slope=slope, planes=planes, density=0.1, curve=rocky(20.0))
    judged = replace(own.site_evidence, spacing=far * LANDER.leg_radius)
    p, known = calibrated_safety(judged)
    # As many sites as a map has.
    prior = unobserved_safety_prior(
        np.tile(p[MEASURED], 400), np.zeros(400 * MEASURED.sum()), 0.5, TERMS
    )
    assert p[:4].max() > prior > p[4:].min()
    own = replace(
        own, surface=replace(own.surface, p_safe=p, in_domain=known), site_evidence=judged
    )
    # The expectation of the mission counts more with fewer measured sites.
    assert 0.9 > fuse_evidence(own, eyes(0.1), TERMS).p_safe[:, 6:].max() > prior


@pytest.mark.parametrize("density", [0.1, 30.0])
@pytest.mark.parametrize("side", [2, SIDE])
def test_terrain_beside_steep_terrain_is_no_safer_for_steeper_terrain(density, side):
    seen = np.zeros(GRID.shape, bool)
    seen[:side, :side] = True
    seen[:, 6:] = False
    slopes = (0.5, 0.85, 0.999, 1.001, 1.5)
    p = [
        fuse_evidence(relief(seen=seen, slope=slope, density=density), eyes(0.1), TERMS).p_safe[
            :, 6:
        ]
        for slope in slopes
    ]
    assert all((worse <= better + 1e-6).all() for better, worse in pairwise(p))


def test_terrain_that_was_not_measured_is_no_safer_than_its_like_that_was():
    for slope, level, density in product((0.5, 0.85, 0.95), (-4.0, 1.0), (0.1, 3.0, 30.0)):
        judged = evidence(slope=slope, level=level, density=density)
        p, _ = calibrated_safety(judged)
        told = np.maximum(p, level_map(judged, 0.9)).ravel()
        free = no_undetected_rock_probability(judged).ravel()
        prior = unobserved_safety_prior(np.tile(told, 400), np.tile(free, 400), GRID.posting, TERMS)
        assert 0.97 * prior <= told.max(), (slope, level, density)


@pytest.mark.parametrize("expected", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("posting", [0.25, 9.0])
def test_terrain_that_was_not_measured_is_never_likelier_than_expected(expected, posting):
    terms = replace(TERMS, terrain_prior=expected)
    rng = np.random.default_rng(5)
    for n, most in ((0, 1.0), (1, 1.0), (7, 1.0), (200, 1.0), (7, 0.0), (200, 0.0)):
        p, free = rng.random(n).astype(np.float32), most * rng.random(n)
        free[rng.random(n) < 0.1] = np.nan
        found = unobserved_safety_prior(p, free, posting, terms)
        told = beside(zip(p.tolist(), free.tolist(), strict=True), expected, posting)
        assert found == pytest.approx(told, rel=1e-5)
        assert found <= expected
        assert unobserved_safety_prior(0.5 * p, free, posting, terms) <= found
        assert unobserved_safety_prior(p, 0.5 * free, posting, terms) <= found
        nought = unobserved_safety_prior(np.where(p > 0.5, 0.0, p), free, posting, terms)
        assert unobserved_safety_prior(np.where(p > 0.5, np.nan, p), free, posting, terms) == nought


def test_beside_a_map_without_samples_terrain_is_as_likely_as_the_map_states():
    own = replace(relief(seen=MEASURED, slope=0.95), site_evidence=None)
    both = fuse_evidence(own, eyes(0.1), TERMS)
    prior = beside((float(p), 1.0) for p in own.surface.p_safe[MEASURED])
    assert both.p_safe[:, 6:] == pytest.approx(prior * 0.97, rel=1e-5)


def test_where_no_elevation_was_measured_rocks_are_as_high_as_where_they_were():
    seen = np.ones(GRID.shape, bool)
    seen[:, 5:] = False
    rock = tracks((3.5, 2.0, 0.6, 0.9))
    told = replace(
        relief(seen=seen, density=1e-6), residual_heights=np.full(GRID.shape, np.nan, np.float32)
    )
    both = fuse_evidence(told, eyes(0.1, rock, p=0.97), TERMS)
    heights = estimate_rock_heights(rock, samples(told), LANDER)
    clear = rock_free_probability(rock, heights, GRID, LANDER)
    free = fuse_evidence(told, eyes(0.1, p=1.0), TERMS).p_safe
    assert both.p_safe[:, 5:] == pytest.approx((free * np.minimum(0.97, clear))[:, 5:], rel=1e-5)
    assert (both.p_safe[:, 5:] < 0.5).any()
