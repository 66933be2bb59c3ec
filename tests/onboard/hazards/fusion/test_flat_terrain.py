"""Test the probability of measured flat terrain: its bounds, and where it is 0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.fusion.flat_terrain import no_missed_rock_probability
from lunarsim.onboard.hazards.fusion.rock_heights import RockHeights
from tests.camera_and_lidar import GRID, eyes, level_map, tracks
from tests.map_evidence import LANDER, SIDE, evidence

LEVEL = {"slope": 0.5, "rough": 0.2, "density": 300.0}


def test_flat_terrain_is_as_likely_as_the_mission_expects_and_never_likelier():
    for prior in (0.0, 0.5, 0.9):
        assert level_map(evidence(**LEVEL), prior) == pytest.approx(prior, abs=1e-3)
    assert (level_map(evidence(**LEVEL), 0.9, 1.0) <= np.float32(0.9)).all()


def test_terrain_that_was_not_measured_or_measured_worse_than_any_that_was_tried_is_none():
    seen = np.ones(GRID.shape, bool)
    seen[3] = False
    p = level_map(evidence(seen=seen, **LEVEL), 0.9)
    assert not p[3].any()
    assert (p[4:] > 0.8).all()
    limit, apart = LANDER.roughness_limit, LANDER.leg_radius
    for worse in ({"noise": 0.51 * limit}, {"spacing": 1.01 * apart}):
        assert not level_map(replace(evidence(**LEVEL), **worse), 0.9, 1.0).any(), worse
    for near in ({"noise": 0.49 * limit}, {"spacing": 0.99 * apart}):
        assert level_map(replace(evidence(**LEVEL), **near), 0.9, 1.0).all(), near


@pytest.mark.parametrize("planes", [-1.5, -2.5, -6.0])
def test_terrain_whose_planes_are_hardly_ever_level_is_no_likelier_than_they_allow(planes):
    judged = evidence(planes=planes, **LEVEL)
    most = 4.0 * min(judged.support_planes.p_slope.max(), judged.support_planes.p_roughness.max())
    assert level_map(judged, 0.9) == pytest.approx(min(most, 0.9), rel=1e-3)


def test_where_a_figure_is_no_number_nothing_is_said():
    judged = evidence(**LEVEL)
    density = judged.density.copy()
    density[4, 4] = np.nan
    assert np.isfinite(level_map(replace(judged, density=density), 0.9)).all()
    slope = np.full(GRID.shape, 0.5)
    slope[2, 2] = np.nan
    p = level_map(evidence(**LEVEL | {"slope": slope}), 0.9)
    assert p[2, 2] == 0.0
    assert (np.delete(p.ravel(), 2 * SIDE + 2) > 0.8).all()


def test_a_sensor_misses_none_only_where_all_about_a_site_was_looked_at():
    fine = Grid(0.0, 0.0, 0.25, 2 * SIDE - 1, 2 * SIDE - 1)
    looked = np.ones(fine.shape, bool)
    # Between two cells of the sites.
    looked[8, 9] = False
    evidence_of_rocks = eyes(
        1.0, of=fine, undetected_probability=np.full(fine.shape, 0.1, np.float32)
    )
    evidence_of_rocks = replace(
        evidence_of_rocks, hazard_map=replace(evidence_of_rocks.hazard_map, observed=looked)
    )
    heights = RockHeights(1.0, np.empty(0), np.empty(0))
    none = no_missed_rock_probability(
        evidence_of_rocks, tracks(), heights, GRID, LANDER.roughness_limit
    )
    assert none[4, 4] == none[4, 5] == 0.0
    assert np.count_nonzero(none == 0.0) <= 6
    assert none[4, 7] == pytest.approx(0.9)
    untold, doubted = (
        replace(evidence_of_rocks, undetected_probability=None),
        replace(evidence_of_rocks, expected_detections=40.0),
    )
    nowhere = replace(doubted.hazard_map, in_domain=np.zeros(fine.shape, bool))
    for silent in (untold, replace(doubted, hazard_map=nowhere)):
        assert not no_missed_rock_probability(
            silent, tracks(), heights, GRID, LANDER.roughness_limit
        ).any()
