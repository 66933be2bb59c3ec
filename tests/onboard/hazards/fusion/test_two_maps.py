"""Test which evidence of two sensors reaches the fused map."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.conservative_probability import ALMOST_CERTAINLY_SAFE_P
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
from lunarsim.onboard.hazards.fusion.rock_existence import existence_given_elevations
from lunarsim.onboard.hazards.fusion.rock_heights import (
    RockHeights,
    estimate_rock_heights,
    rock_free_probability,
)
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import DemSnapshot
from lunarsim.onboard.hazards.gaussian_dem.pooled import pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.samples import SamplePool
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.map_evidence import TerrainEvidence
from lunarsim.rocks.population import RockExpectation
from tests.camera_and_lidar import (
    DOUBTED,
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
from tests.map_evidence import LANDER, evidence


def test_terrain_measured_to_be_level_counts_as_the_mission_expects_beside_steep_terrain():
    slope = np.full(GRID.shape, 0.4, np.float32)
    slope[:6] = 1.3
    own = replace(relief(slope=slope, rough=0.3, **DOUBTED), residual_heights=SAMPLED)
    both = fuse_evidence(own, eyes(1.0, undetected_probability=raster(0.2)), TERMS)
    assert both.p_safe[6:] == pytest.approx(0.9 * 0.8)
    assert (both.p_safe[:6] < 0.01).all()


@pytest.mark.parametrize("there", [0.98, 0.999])
def test_a_site_that_a_tracked_rock_makes_unsafe_is_no_frequency_for_that(there):
    # Elevations that show the rock leave its odds unchanged.
    bump = np.zeros(GRID.shape)
    bump[4, 4] = 0.6 * LANDER.roughness_limit
    own = relief(bump, slope=0.1, rough=0.1, density=300.0)
    assert (own.hazard_map.p_safe >= ALMOST_CERTAINLY_SAFE_P).all()
    both = fuse_evidence(own, eyes(0.1, tracks((2.0, 2.0, 0.4, there))), TERMS)
    assert both.p_safe[4, 4] < 0.05
    assert not both.in_domain[4, 4]


def test_elevations_are_those_measured_and_else_the_other_sensors():
    seen = np.ones(GRID.shape, bool)
    seen[:, 5:] = False
    z = np.where(seen, 2.0, np.nan)
    own = relief(z, seen=seen)
    spread = raster(0.01)
    own = replace(own, surface=replace(own.hazard_map, variance=spread))
    both = fuse_evidence(own, eyes(0.1), TERMS)
    assert (both.elevation[:, :5] == 2.0).all()
    assert (both.elevation[:, 5:] == 0.0).all()
    assert both.variance is spread
    # The same holds for elevations without site evidence.
    z = own.surface.elevation
    bare = SimpleNamespace(grid=GRID, observed=seen, elevation=z, variance=spread)
    unjudged = fuse_evidence(
        replace(own, surface=bare, compute_map=lambda: own.hazard_map), eyes(0.1), TERMS
    )
    for f in fields(HazardMap):
        one, other = (getattr(drawn, f.name) for drawn in (unjudged, both))
        assert np.array_equal(one, other), f.name


def test_off_the_camera_map_rocks_are_as_many_as_expected():
    wide, small = Grid(0.0, 0.0, 0.5, 41, 41), Grid(0.1, 0.2, 0.4, 40, 22)
    ratio = footprint_undetected_ratio(eyes(0.3, of=small), wide, TERMS).ratio
    assert ratio[:, 14, 8] == pytest.approx(0.3)
    assert (ratio[:, :, 25:] == 1.0).all()


def test_of_untracked_rocks_on_other_cells_the_most_nearby_count():
    own = replace(relief(slope=0.4, rough=0.2, **DOUBTED), residual_heights=SAMPLED)
    fine = Grid(0.0, 0.0, 0.25, 17, 17)
    unseen = np.full(fine.shape, 0.1, np.float32)
    # Between two cells of the elevation map.
    unseen[8, 9] = 0.7
    both = fuse_evidence(
        own, eyes(1.0, of=fine, undetected_probability=unseen), replace(TERMS, terrain_prior=0.8)
    )
    assert both.p_safe[4, 4] == pytest.approx(0.8 * 0.3)
    assert both.p_safe[4, 5] == pytest.approx(0.8 * 0.3)
    assert both.p_safe[4, 7] == pytest.approx(0.8 * 0.9)


@pytest.mark.parametrize(("there", "x", "counts"), [(0.9, 2.0, 1), (0.4, 2.0, 0), (0.9, 99.0, 0)])
def test_rocks_that_hardly_are_any_or_lie_off_the_map_do_not_speak_for_a_sensor(there, x, counts):
    rocks = tracks(*((x, 0.3 * k, 0.4, there) for k in range(12)))
    found = replace(eyes(1.0, rocks, expected_detections=40.0))
    found = replace(
        found, hazard_map=replace(found.hazard_map, in_domain=np.zeros(GRID.shape, bool))
    )
    heights = RockHeights(1.0, np.full(12, there), np.full(12, 0.3))
    assert is_detection_count_plausible(found, rocks, heights, LANDER.roughness_limit) == bool(
        counts
    )


# --- tracked rocks -----------------------------------------------------------------------------


def test_rocks_that_elevations_without_samples_do_not_show_are_less_likely():
    own, rocks = relief(density=100.0), tracks((2.0, 2.0, 0.4, 0.8))
    both = fuse_evidence(own, eyes(1.0, rocks), TERMS)
    there = existence_given_elevations(rocks, own, LANDER)
    assert there[0] < 0.2
    expected = own.hazard_map.p_safe * clear(replace(rocks, existence=there))
    assert both.p_safe == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("shape", ["hemisphere", "cube", "ellipsoid"])
def test_rocks_are_where_the_samples_have_them_and_of_the_shape_that_is_expected(shape):
    expected = replace(TERMS.rocks, shape=shape, height_ratio=(0.4, 0.5))
    ratio = {"hemisphere": 0.5, "cube": 1.0, "ellipsoid": 0.4}[shape]
    places = np.array([(0.5, 0.5), (3.0, 1.0), (2.0, 3.0), (1.0, 2.5)])
    residual_heights = np.zeros(GRID.shape, np.float32)
    row, col = GRID.cell(places + [0.5, 0.0])
    residual_heights[row, col] = 0.7 * ratio
    rocks = tracks(*((x, y, 0.5, 0.9) for x, y in places))
    rocks = replace(rocks, sigma=np.full(4, 0.4))
    own = replace(relief(density=6.0), residual_heights=residual_heights)
    told = replace(samples(own), height_ratio=ratio)
    # Without measurements, shadows are assumed to underestimate radii.
    placed = register_tracks(rocks, told, 1.2 * 2.0 * ratio)
    assert np.abs(placed.xy - rocks.xy).max() > 0.1
    free = rock_free_probability(
        placed, estimate_rock_heights(placed, told, LANDER, shape), GRID, LANDER
    )
    both = fuse_evidence(own, eyes(1.0, rocks), replace(TERMS, rocks=expected))
    assert both.p_safe == pytest.approx(own.hazard_map.p_safe * free, rel=1e-5)


# --- a calibration for the scenario ------------------------------------------------------------


def own_calibration(log_odds: float = -3.0) -> ScenarioCalibration:
    """Return a calibration that makes sites much less safe everywhere, by constant odds."""
    wide = CalibrationDomain(10.0, 10.0, (0.0, 0.5), (0.01, 1.0))
    figures = lander_safety_params(LANDER)
    return ScenarioCalibration(
        CalibrationStage(log_odds), CalibrationStage(log_odds), wide, figures,
        GAUSSIAN_DEM.packaged.digest,
    )  # fmt: skip


def test_what_is_left_of_rocks_is_evaluated_by_the_calibration_of_the_elevations():
    judged, refit = evidence(slope=0.7, rough=0.5, density=5.0), own_calibration()
    p, known = calibrated_safety(judged, refit=refit)
    drawn = HazardMap(GRID, p, judged.observed, SAMPLED, in_domain=known)
    rocks = eyes(0.3)
    both = fuse_evidence(TerrainEvidence(drawn, judged, refit), rocks, TERMS)
    thinned = replace(judged, undetected_rock_ratio=footprint_undetected_ratio(rocks, GRID, TERMS))
    expected, _ = calibrated_safety(thinned, refit=refit)
    assert np.array_equal(both.p_safe, expected)
    assert (both.p_safe != calibrated_safety(thinned)[0]).all()


def test_elevations_are_evaluated_by_the_calibration_they_were_drawn_with():
    pool = SamplePool(Grid.centred((0.0, 0.0), 8.0, 0.25))
    xy = np.random.default_rng(1).uniform(-3.9, 3.9, (1200, 2))
    pool.add(np.column_stack((xy, np.zeros(1200))), 0.01, 0.2)
    plain = DemSnapshot(pooled_dem(pool), LANDER, RockExpectation())
    own = replace(plain, scenario_calibration=own_calibration(-8.0))
    assert plain.hazard_map.observed.any()
    assert not plain.hazard_map.observed.all(), "the footprint leaves the map at its edge"
    for one in (plain, own):
        p, known = calibrated_safety(one.site_evidence, refit=one.scenario_calibration)
        assert np.array_equal(one.hazard_map.p_safe, p)
        assert np.array_equal(one.hazard_map.in_domain, known)
        assert np.array_equal(one.observed, one.site_evidence.observed)
        assert one.hazard_map.elevation is one.elevation
    assert (own.hazard_map.p_safe < plain.hazard_map.p_safe)[plain.observed].any()
