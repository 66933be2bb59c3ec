"""What was seen and what may stand unseen, over whole footprints."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap
from lunarsim.onboard.hazards.shadows.footprints import disc_mean, footprint_observed
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.rocks.size_distribution import golombek_number
from tests.shadow_scene import MODEL, SUN, picture, rocks_on_a_plane, tracker_at

GRID = Grid.centred((0.0, 0.0), 60.0, 0.25)


def test_mean_over_discs_is_that_of_points_drawn_in_them():
    rng = np.random.default_rng(0)
    layer = rng.random((23, 31))
    radius = 3.7
    found = disc_mean(layer, radius, 0.4)
    for i, j in ((11, 15), (0, 0), (22, 4), (5, 30)):
        angle, away = 2.0 * np.pi * rng.random(40_000), radius * np.sqrt(rng.random(40_000))
        rows = np.rint(i + away * np.sin(angle)).astype(int)
        cols = np.rint(j + away * np.cos(angle)).astype(int)
        on = (rows >= 0) & (rows < 23) & (cols >= 0) & (cols < 31)
        drawn = np.where(on, layer[np.clip(rows, 0, 22), np.clip(cols, 0, 30)], 0.4)
        assert found[i, j] == pytest.approx(drawn.mean(), abs=0.01)


def test_a_footprint_is_seen_where_its_whole_disc_is():
    seen = np.zeros((60, 60), bool)
    seen[:, 30:] = True
    whole = footprint_observed(seen, 6.0)
    assert not whole[:, :33].any()
    # At least a tenth of the disc lies beyond the edge until its middle is 4.1 cells behind it.
    assert not whole[30, 33] and whole[30, 35:54].all()
    assert not whole[:6].any() and not whole[:, -6:].any()
    assert np.array_equal(footprint_observed(seen, 0.0), seen)
    assert not footprint_observed(np.ones((9, 9), bool), 6.0).any()


LINE = (1001.0, -1000.0, 1e-9)
PERFECT = DetectionRates(missed=LINE, false_clear_line=LINE)


def half_seen(prior=None):
    """A map whose eastern half was seen from near by, and the other never looked at."""
    mapping = ProbabilityMap(GRID, MODEL, prior or HazardPrior(0.05, 0.5), PERFECT)
    mapping.evidence.lit[:, :, mapping.evidence.grid.cols // 2 :] = 1e3
    return mapping


def test_of_a_disc_of_which_half_was_never_seen_half_the_rocks_are_unseen():
    """Closed form: rocks that reach into the disc from the half that was not seen."""
    mapping = half_seen()
    tracker = tracker_at((0.0, 0.0, 40.0))
    radius = 2.0
    edges = np.geomspace(0.5, 4.0, 2000)
    number = -np.diff(golombek_number(edges, 0.05))
    reach = radius + 0.25 * (edges[1:] + edges[:-1])
    whole = float(np.sum(number * np.pi * reach**2))
    p = mapping.probability(tracker, radius)
    middle = GRID.rows // 2
    blocks = mapping.observed
    assert not blocks[middle, : GRID.cols // 2 - 2].any()
    edge = int(np.flatnonzero(blocks[middle])[0])
    # Half of the disc is seen between the first block that is and the last that is not.
    between = 0.5 * (p[middle, edge - 1] + p[middle, edge])
    assert between == pytest.approx(1.0 - np.exp(-0.5 * whole), rel=0.03)
    assert p[middle, edge - 30] == pytest.approx(1.0 - np.exp(-whole), rel=0.02)
    assert p[middle, edge + 30] < 1e-6
    drawn = mapping.hazard_map(tracker, radius)
    assert not drawn.observed[middle, : edge + 4].any()
    assert drawn.observed[middle, edge + 10]


def test_nothing_off_the_map_was_seen():
    small = Grid.centred((0.0, 0.0), 20.0, 0.25)
    mapping = ProbabilityMap(small, MODEL, HazardPrior(0.05, 0.5), PERFECT)
    mapping.evidence.lit[:, small.contains(mapping.evidence.grid.centres())] = 1e3
    p = mapping.probability(tracker_at((0.0, 0.0, 40.0)), 2.0)
    fresh = ProbabilityMap(small, MODEL, HazardPrior(0.05, 0.5), PERFECT)
    never = float(fresh.probability(tracker_at((0.0, 0.0, 40.0)), 2.0)[40, 40])
    assert p[40, 40] < 1e-6
    assert 0.3 * never < p[40, 0] < 0.55 * never
    assert 0.5 * never < p[0, 0] < 0.8 * never


def test_few_rocks_expected_make_no_terrain_clear_before_it_is_seen():
    for cover in (0.01, 0.02, 0.03):
        mapping = ProbabilityMap(GRID, MODEL, HazardPrior(cover, 0.5))
        tracker = tracker_at((0.0, 0.0, 40.0))
        assert mapping.probability(tracker).max() < 0.0025
        assert not mapping.observed.any()
        drawn = mapping.hazard_map(tracker, 1.5)
        assert not drawn.observed.any() and not drawn.p_safe.any()


@pytest.mark.parametrize("elevation", [90.0, 85.0, 1.0, -20.0])
def test_nothing_is_seen_under_a_sun_without_shadows(elevation):
    mapping = ProbabilityMap(GRID, MODEL)
    state, camera, counts = picture(rocks_on_a_plane("hemisphere", count=1), (0.0, 0.0, 40.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    e = np.radians(elevation)
    sun = np.array([np.cos(e), 0.0, np.sin(e)])
    mapping.add_image(camera.view(state), sun, seen)
    assert not mapping.observed.any()
    with pytest.raises(InputError, match="sun"):
        mapping.add_image(camera.view(state), 2.0 * sun, seen)


def test_pixels_that_are_no_numbers_show_nothing():
    mapping = ProbabilityMap(GRID, MODEL)
    state, camera, counts = picture(rocks_on_a_plane("hemisphere", count=1), (0.0, 0.0, 40.0))
    gap = counts.astype(float)
    gap[200:280, 280:360] = np.nan
    seen = detect_rocks(gap, camera, state, SUN, model=MODEL)
    mapping.add_image(camera.view(state), SUN, seen)
    assert not mapping.observed[GRID.rows // 2, GRID.cols // 2]
    assert mapping.observed[GRID.rows // 2, GRID.cols // 2 + 40]


def test_rocks_that_should_be_found_are_those_expected_where_it_was_seen():
    mapping = half_seen()
    density = float(golombek_number(0.5, 0.05) - golombek_number(4.0, 0.05))
    area = np.count_nonzero(mapping.observed) * GRID.posting**2
    assert area > 400.0
    assert mapping.expected_rocks() == pytest.approx(area * density, rel=0.02)


@pytest.mark.parametrize("form", ["exact", "Rice", "", None])
def test_a_form_that_there_is_not_is_refused(form):
    with pytest.raises(InputError, match="cover_model"):
        ProbabilityMap(GRID, MODEL, form=form)
