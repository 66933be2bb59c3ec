"""What was noted of places moves with the rocks."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap
from lunarsim.onboard.hazards.shadows.map_motion import MapMotion
from tests.shadow_scene import MODEL, tracker_at

GRID = Grid.centred((3.0, -2.0), 30.0, 0.25)


def rocks_over(side, count, rng):
    return rng.uniform(-side, side, (count, 2)) + [3.0, -2.0]


def test_many_rocks_give_a_shift_a_rotation_and_a_scale():
    rng = np.random.default_rng(4)
    places = rocks_over(15.0, 50, rng)
    slide = MapMotion(np.array(GRID.centre))
    true = places
    for turn, stretch, shift in ((0.2, 1.01, (0.4, -0.3)), (-0.15, 0.98, (-0.1, 0.9))):
        matrix = stretch * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        rocks = rocks_over(40.0, 600, rng)
        moved = rocks @ matrix.T + shift
        noise = rng.normal(0.0, 0.05, rocks.shape)
        slide.follow(moved + noise, moved + noise - rocks)
        true = true @ matrix.T + shift
    assert np.abs(true - places).max() > 0.5
    assert slide.to_current(places) == pytest.approx(true, abs=0.15)
    assert slide.to_stored(slide.to_current(places)) == pytest.approx(places, abs=1e-9)
    slide.forget()
    assert slide.is_identity
    assert slide.to_current(places) == pytest.approx(places, abs=1e-12)


def test_few_rocks_move_the_terrain_as_a_whole_and_none_do_not():
    slide = MapMotion(np.zeros(2))
    nothing = np.full((3, 2), np.nan)
    slide.follow(np.ones((3, 2)), nothing)
    slide.follow(np.empty((0, 2)), np.empty((0, 2)))
    assert slide.is_identity
    slide.follow(np.array([[5.0, 0.0], [0.0, 5.0]]), np.array([[0.5, 0.2], [0.3, 0.4]]))
    far = np.array([[30.0, -30.0]])
    assert slide.to_current(far) - far == pytest.approx(np.array([[0.4, 0.3]]), abs=0.2)


def test_a_rock_that_moves_otherwise_than_the_rest_does_not_count():
    rng = np.random.default_rng(5)
    rocks = rocks_over(20.0, 40, rng)
    by = np.tile([0.3, 0.1], (40, 1)) + rng.normal(0.0, 0.01, (40, 2))
    by[:4] = [-3.0, 2.0]
    slide = MapMotion(np.array(GRID.centre))
    slide.follow(rocks + by, by)
    middle = np.array(GRID.centre)
    assert slide.to_current(middle) - middle == pytest.approx([0.3, 0.1], abs=0.02)


def test_the_map_shows_what_was_seen_where_it_lies_now():
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    assert not mapping.observed.any()
    rng = np.random.default_rng(6)
    lit = GRID.contains(mapping.evidence.grid.centres())
    lit &= rng.random(lit.shape) < 0.5
    mapping.evidence.lit[:, lit] = 1e3
    before, seen = mapping.probability(tracker_at((0.0, 0.0, 50.0))), mapping.observed
    assert seen.mean() == pytest.approx(0.5, abs=0.05)
    rocks = rocks_over(20.0, 50, rng)
    mapping.move_with_rocks(rocks, np.full((50, 2), [1.0, -0.5]))
    shifted = mapping.observed
    assert (shifted[:-2, 4:] == seen[2:, :-4]).all()
    # Of what slides in from beyond the map nothing was noted.
    assert not shifted[-2:].any()
    assert not shifted[:, :4].any()
    after = mapping.probability(tracker_at((0.0, 0.0, 50.0)))
    assert after[:-2, 4:] == pytest.approx(before[2:, :-4])
    assert after[-1, 0] == pytest.approx(mapping.evidence.expected_unobserved(), rel=1e-4)
    mapping.move_with_rocks(rocks, np.full((50, 2), [4.0, 0.0]))
    off_the_blocks = mapping.probability(tracker_at((0.0, 0.0, 50.0)))[0, 0]
    assert off_the_blocks == pytest.approx(mapping.evidence.expected_unobserved(), rel=1e-4)
    mapping.evidence.forget()
    assert mapping.evidence.motion.is_identity


def test_rocks_report_by_how_far_they_were_moved_since_they_were_asked():
    one = tracker_at((0.0, 0.0, 50.0))
    one.add_known([[1.0, 2.0], [5.0, -3.0]], 0.1, 0.4, 0.05)
    stand, by = one.moved()
    assert stand == pytest.approx(np.array([[1.0, 2.0], [5.0, -3.0]]))
    assert np.isnan(by).all()
    one.filter.xyz[:, :2] += [0.4, -0.2]
    one.add_known([[9.0, 9.0]], 0.1, 0.4, 0.05)
    assert one.moved()[1][:2] == pytest.approx(np.tile([0.4, -0.2], (2, 1)))
    assert one.moved()[1] == pytest.approx(np.zeros((3, 2)))
