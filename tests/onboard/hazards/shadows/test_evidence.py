"""What pictures say of rocks that are not tracked, against plain loops and pictures of rocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap
from lunarsim.onboard.hazards.shadows.clear_evidence import ClearEvidence
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.world.terrain import Terrain
from tests.shadow_scene import MODEL, SUN, picture, rocks_on_a_plane
from tests.worlds import flat_terrain

GRID = Grid.centred((0.0, 0.0), 30.0, 0.25)
DIAMETERS = np.array([0.5, 0.6, 0.9, 1.5])
NUMBER = np.array([0.01, 0.005, 0.002, 0.0005])


def level(height=0.0):
    return lambda xy: np.full(len(xy), height)


def viewing_angles(terrain, place):
    state, camera, counts = picture(terrain, place)
    return camera.view(state), detect_rocks(counts, camera, state, SUN, model=MODEL)


def test_unseen_rocks_are_integrated_over_the_disc():
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    # The western half was seen so sharply that only the least rate of misses is left.
    evidence.lit[:, :, : GRID.cols // 2] = 1e3
    least = DetectionRates().false_clear_line[2]
    for footprint in (0.0, 1.5):
        whole = float(NUMBER @ (np.pi * (footprint + 0.5 * DIAMETERS) ** 2))
        expected = evidence.expected_untracked(footprint)
        assert expected[60, 10] == pytest.approx(least * whole, rel=1e-3)
        assert expected[60, -10] == pytest.approx(whole, rel=1e-3)
        # On the line between them half of the disc was seen.
        line = 0.5 * (expected[60, 59] + expected[60, 60])
        assert line == pytest.approx(0.5 * (1.0 + least) * whole, rel=1e-3)


def test_rocks_that_must_be_somewhere_are_where_they_may_be():
    """Over ground of which only a part may hide a rock the expected number is still the law's."""
    evidence = ClearEvidence(
        GRID, MODEL, DIAMETERS, NUMBER, DetectionRates(false_clear_line=(1.0, -9.0, 1e-9))
    )
    evidence.lit[:] = 1e3
    evidence.dark[:, 40:50, 70:90] = 1e3
    per_metre = evidence.expected_untracked() / np.sum(NUMBER * np.pi * (0.5 * DIAMETERS) ** 2)
    assert per_metre.sum() == pytest.approx(GRID.rows * GRID.cols, rel=0.02)
    assert evidence.is_observed()[10, 10]
    assert not evidence.is_observed()[45, 80]


def test_rocks_are_as_crowded_as_terrain_that_was_looked_at_leaves_room_for():
    """Ground that is dark to the only look was looked at too."""
    evidence = ClearEvidence(
        GRID, MODEL, DIAMETERS, NUMBER, DetectionRates(false_clear_line=(1.0, -9.0, 1e-9))
    )
    evidence.lit[:, :60] = 1e3
    evidence.dark[:, 60:90] = 1e3
    per_metre = evidence.expected_untracked() / np.sum(NUMBER * np.pi * (0.5 * DIAMETERS) ** 2)
    assert per_metre[70, 60] == pytest.approx(3.0, rel=0.01)


def test_sizes_of_which_none_are_expected_stand_nowhere():
    evidence = ClearEvidence(
        GRID, MODEL, DIAMETERS, NUMBER * [1.0, 1.0, 1.0, 0.0], DetectionRates()
    )
    evidence.lit[:] = 1e3
    evidence.dark[:, 60:90] = 2e3
    assert np.isfinite(evidence.untracked_rock_ratios()).all()
    assert np.isfinite(evidence.expected_untracked()).all()


def test_one_observation_stands_for_sizes_within_a_factor_and_the_last_for_all_larger():
    sizes = 0.5 * 1.4 ** np.arange(8)
    evidence = ClearEvidence(GRID, MODEL, sizes, np.ones(8), DetectionRates())
    assert evidence.size_class_diameters == pytest.approx(sizes[:4])


def test_the_shadow_of_a_tracked_rock_hides_others_no_more_than_other_terrain():
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    evidence.lit[:] = 1e3
    evidence.dark[:, 40:60, 40:60] = 1e3
    evidence.explained[:, 40:60, 40:60] = True
    prior = float(NUMBER @ (np.pi * (0.5 * DIAMETERS) ** 2))
    assert evidence.expected_untracked()[50, 50] == pytest.approx(prior, rel=1e-3)
    assert not evidence.is_observed()[50, 50]


@pytest.mark.parametrize("size", [0.3, 0.7])
def test_a_rock_that_no_detection_reports_is_not_cleared(size):
    """Its shadow is there, whatever the detector makes of it; the ground about it is clear."""
    rocks = RockField.hemispheres([-6.0, 5.0], [2.0, -3.0], 0.0, size)
    terrain = Terrain(flat_terrain(400.0, 10.0).relief, rocks)
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    for place in [(-9.0, 4.0, 45.0), (2.0, 3.0, 38.0)]:
        view, seen = viewing_angles(terrain, place)
        assert len(seen) == 2
        hidden = replace(seen, largest=np.where(seen.largest > 0, np.inf, 0.0).astype(np.float32))
        evidence.add_image(view, SUN, hidden, level())
    away = np.min(
        [np.hypot(*np.moveaxis(GRID.centres() - c, -1, 0)) for c in ((-6.0, 2.0), (5.0, -3.0))], 0
    )
    prior = float(NUMBER @ (np.pi * (0.5 * DIAMETERS) ** 2))
    expected = evidence.expected_untracked()
    assert expected[away < 0.7 * size].min() > prior
    # Beyond the edge nothing was seen, and rocks reach in from there.
    far = (away > 6.0 * size)[8:-8, 8:-8]
    assert expected[8:-8, 8:-8][far].max() < 0.2 * prior
    assert evidence.is_observed()[away > 6.0 * size].all()


@pytest.mark.parametrize(("blur", "wider"), [(0.3, 1.0), (0.6, 1.0), (0.9, 1.42), (1.8, 2.74)])
def test_a_camera_that_spreads_light_wider_sees_as_one_of_larger_pixels(blur, wider):
    """By root squares of the point spread and a pixel's own 0.29."""
    rocks = RockField.hemispheres([-6.0], [2.0], 0.0, 0.6)
    view, seen = viewing_angles(Terrain(flat_terrain(400.0, 10.0).relief, rocks), (0.0, 0.0, 35.0))
    found = {}
    for point_spread in (0.6, blur):
        evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
        evidence.add_image(view, SUN, seen, level(), blur=point_spread)
        found[point_spread] = evidence.lit.max()
    assert found[0.6] / found[blur] == pytest.approx(wider, rel=0.01)


def test_a_shadow_that_is_too_small_for_a_hazard_leaves_the_terrain_clear():
    rocks = RockField.hemispheres([-6.0, 5.0], [2.0, -3.0], 0.0, [0.12, 0.6])
    terrain = Terrain(flat_terrain(400.0, 10.0).relief, rocks)
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    view, seen = viewing_angles(terrain, (0.0, 0.0, 35.0))
    mapping.evidence.add_image(view, SUN, seen, level())
    row, col = mapping.evidence.grid.cell(np.array([[-6.0, 2.0], [5.0, -3.0]]))
    expected = mapping.evidence.expected_untracked()
    assert expected[row[0], col[0]] < 0.0025
    assert expected[row[1], col[1]] > 0.0025


def test_shadows_are_cast_onto_the_terrain_as_it_is_known():
    """On ground taken for 8 m too low the shadow is looked for beside itself."""
    rocks = RockField.hemispheres([0.0], [0.0], 0.0, 0.6)
    terrain = Terrain(flat_terrain(400.0, 10.0).relief, rocks)
    view, seen = viewing_angles(terrain, (-25.0, 0.0, 30.0))
    middle = {}
    for height in (0.0, -8.0):
        evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
        evidence.add_image(view, SUN, seen, level(height))
        middle[height] = bool(evidence.is_observed()[58:62, 58:62].any())
    assert middle == {0.0: False, -8.0: True}


def test_an_image_without_any_shadow_says_nothing():
    empty = Terrain(flat_terrain(400.0, 10.0).relief)
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    view, seen = viewing_angles(empty, (0.0, 0.0, 40.0))
    evidence.add_image(view, SUN, seen, level())
    assert not evidence.is_observed().any()
    # One shadow shows that the picture can show shadows.
    view, seen = viewing_angles(rocks_on_a_plane("hemisphere", count=3), (0.0, 0.0, 40.0))
    evidence.add_image(view, SUN, seen, level())
    assert evidence.is_observed().mean() > 0.8
    evidence.forget()
    assert not evidence.is_observed().any()


def test_what_is_seen_where_places_are_not_known_belongs_elsewhere():
    """West of the middle places are known to less than the radius of the least rock."""
    view, seen = viewing_angles(rocks_on_a_plane("hemisphere", count=3), (0.0, 0.0, 40.0))
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    least = 0.5 * DIAMETERS[0]
    evidence.add_image(
        view, SUN, seen, level(),
        position_sigma=lambda xy: np.where(xy[:, 0] < -1.0, 0.9 * least, 1.1 * least),
    )  # fmt: skip
    assert evidence.is_observed()[:, :50].mean() > 0.8
    assert not evidence.is_observed()[:, 80:].any()
    assert not (evidence.lit[:, :, 80:].any() or evidence.dark[:, :, 80:].any())


def test_ratios_are_what_observations_say_of_rocks_that_are_expected():
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    assert (evidence.untracked_rock_ratios() == 1.0).all()
    evidence.lit[:, 10:100, 10:100] = 1e3
    evidence.dark[:, 40:50, 40:50] = 2e3
    evidence.dark[:, 60:70, 60:70] = 2e3
    evidence.explained[:, 60:70, 60:70] = True
    ratio = evidence.untracked_rock_ratios()
    assert ratio.shape == (len(evidence.size_class_diameters), *GRID.shape)
    assert (np.diff(evidence.size_class_diameters) > 0.0).all()
    assert ratio[:, 20, 20] == pytest.approx(DetectionRates().false_clear_line[2])
    # Rocks that are not tracked stand in the dark: as many as the sharpest look misses.
    share = 100 / (90 * 90 - 100)
    assert ratio[:, 45, 45] == pytest.approx(DetectionRates().missed[2] / share, rel=0.02)
    # What a tracked rock's shadow hides is as it was, as is what nobody looked at.
    assert (ratio[:, 65, 65] == 1.0).all()
    assert (ratio[:, 5, 5] == 1.0).all()


@pytest.mark.parametrize(
    ("pixels", "by", "taken_back"),
    [(4.9, 1.49, False), (4.9, 1.51, True), (5.1, 1.14, False), (5.1, 1.16, True)],
)
def test_a_lit_observation_takes_back_a_dark_one_if_it_is_much_sharper_or_plain(
    pixels, by, taken_back
):
    """Of the least rock so many pixels show to the lit look, sharper than the dark one by a factor.

    Rocks that are larger by a fifth and more show more: for them the second of two is plain.
    """
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    evidence.lit[:] = pixels / (0.5 * DIAMETERS[0])
    evidence.dark[:, 40:50, 40:50] = evidence.lit[0, 0, 0] / by
    assert evidence.is_observed()[45, 45] == taken_back
    ratio = evidence.untracked_rock_ratios()[:, 45, 45]
    assert (ratio[0] < 1.0) == taken_back
    assert (ratio[-1] < 1.0) == (by > 1.15)
    assert evidence.is_observed()[20, 20]


def test_nothing_is_seen_where_rocks_may_show_nothing_dark():
    faceted = ShadowModel(np.radians(60.0), RockModel("irregular"))
    evidence = ClearEvidence(GRID, faceted, DIAMETERS, NUMBER, DetectionRates())
    evidence.lit[:] = 1e3
    assert not evidence.is_observed().any()
    # Those that show nothing are missed by the sharpest look.
    whole = float(NUMBER @ (np.pi * (0.5 * DIAMETERS) ** 2))
    assert evidence.expected_untracked()[60, 60] == pytest.approx(
        faceted.shadowless_fraction * whole, rel=1e-3
    )
    low = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    low.lit[:] = 1e3
    assert low.is_observed().all()


class Uneven(ShadowModel):
    """Half spheres on ground that slopes."""

    slope = 0.364


def test_a_shadow_that_rising_terrain_cuts_short_is_still_looked_for():
    """On slopes as steep as the Sun is high more than half of a shadow may be lit."""
    rocks = RockField.hemispheres([0.0], [0.0], 0.0, 0.6)
    terrain = Terrain(flat_terrain(400.0, 10.0).relief, rocks)
    view, seen = viewing_angles(terrain, (0.0, 0.0, 40.0))
    # But for the nearest part the shadow is lit.
    v, u = np.indices(seen.labels.shape)
    ray = np.stack(((u - view.cx) / view.fx, (v - view.cy) / view.fy, np.ones(u.shape)), -1)
    ray = ray @ view.axes.T
    ground = view.position[:2] - ray[..., :2] * (view.position[2] / ray[..., 2])[..., None]
    along = ground @ SUN[:2]
    dark = seen.labels > 0
    far = np.where(along > np.quantile(along[dark], 0.8), seen.labels, 0).astype(np.int32)
    cut = replace(seen, labels=far, largest=np.where(seen.largest > 0, np.inf, 0.0))
    found = {}
    for model in (MODEL, Uneven(np.radians(20.0))):
        size = np.array([1.2])
        evidence = ClearEvidence(GRID, model, size, np.array([0.01]), DetectionRates())
        evidence.add_image(view, SUN, cut, level())
        found[model.slope] = bool((evidence.dark > 0.0).any())
    assert found == {0.0: False, 0.364: True}
