"""The mapper where pictures or the Sun are not what they should be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import direction_from_angles
from lunarsim.grid import Grid
from lunarsim.messages.measurements import CameraImage
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap, ShadowMapper
from lunarsim.onboard.hazards.shadows.viewing_geometry import cell_centres
from lunarsim.onboard.perception.image_quality import (
    ImageQualityCheck,
    ImageRejection,
)
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.world import World
from lunarsim.world.light import Light
from tests.picture_faults import all_faults
from tests.shadow_scene import MODEL, SUN, at, picture, rocks_on_a_plane, tracker_at
from tests.slopes import Slope

PLACE = (0.0, 0.0, 50.0)


@pytest.fixture(scope="module")
def scene():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    state, camera = at(PLACE)
    world = World(terrain, 1.622, Light(1.2, np.radians(20.0)))
    rng = np.random.default_rng(0)
    # No frame is like one of the last.
    return camera.model, [camera.expose(world, state, 0.0, rng).counts for _ in range(5)]


def look(scene, times, sun=SUN, counts=None):
    camera, honest = scene
    tracker = tracker_at(PLACE)
    prior = HazardPrior(0.05, 0.5)
    mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), MODEL, prior)
    mapper = ShadowMapper(tracker, mapping, sun, 1.0)
    for k, time in enumerate(times):
        see(mapper, camera, honest[k % len(honest)] if counts is None else counts, time)
    return mapper


def test_where_no_rock_is_tracked_images_show_no_clear_terrain(scene):
    """From picture to picture the lander errs by more than a rock: lit ground is anywhere."""
    camera, honest = scene
    tracker = tracker_at(PLACE, max_birth_sigma=1e-6, min_radius=5.0, min_rocks_in_view=0)
    mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), MODEL, HazardPrior(0.05, 0.5))
    mapper = ShadowMapper(tracker, mapping, SUN, 1.0)
    for k in range(5):
        see(mapper, camera, honest[k], 0.1 * k)
    assert mapper.tracker.filter.count == 0 and len(mapper.seen) > 20
    assert not mapper.hazard_map().observed.any()
    # The same pictures show clear ground where rocks are tracked.
    assert look(scene, 0.1 * np.arange(5)).hazard_map().observed.any()


def see(mapper, camera, counts, time):
    rocks = mapper.tracker.filter
    estimate = rocks.inertial.estimate(rocks.covariance, time, 1.0)
    mapper.update(CameraImage(time, counts, camera), estimate)


@pytest.mark.parametrize("level", [0, 255])
def test_black_and_white_images_clear_nothing(scene, level):
    mapper = look(scene, np.arange(5.0), counts=np.full((480, 640), level, np.uint8))
    assert mapper.tracker.filter.count == 0
    assert not mapper.hazard_map().observed.any()
    # Nor do they take back what was seen, or make rocks doubtful.
    mapper = look(scene, 0.1 * np.arange(8))
    count, exists = mapper.tracker.filter.count, mapper.tracker.existence.copy()
    for k in range(20):
        see(mapper, scene[0], np.full((480, 640), level, np.uint8), 1.0 + 0.1 * k)
    assert mapper.tracker.filter.count == count > 20
    assert np.array_equal(mapper.tracker.existence, exists)
    assert [e.name for e in mapper.tracker.filter.events] == ["image-rejected"]


def test_images_do_not_run_backwards(scene):
    mapper = look(scene, [0.0, 1.0])
    for time in (0.9, np.nan):
        with pytest.raises(InputError, match=r"image\.time"):
            see(mapper, scene[0], scene[1][4], time)


@pytest.mark.parametrize("turn", [45.0, 180.0])
def test_a_sun_that_stands_elsewhere_is_noticed_and_the_map_claims_nothing(scene, turn):
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    wrong = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ SUN
    mapper = look(scene, 0.5 * np.arange(8), wrong)
    rocks = mapper.tracker.filter
    assert rocks.lost
    assert ("lost", "rocks' shadows") in [
        (e.name, e.details.get("measurement")) for e in rocks.events
    ]
    assert not mapper.hazard_map().observed.any()


def test_the_sun_where_it_is_raises_no_doubt(scene):
    mapper = look(scene, 0.5 * np.arange(12))
    assert not mapper.tracker.filter.lost
    assert mapper.tracker.filter.image_monitor.monitors["shadows"].dof >= 10
    assert mapper.hazard_map().observed.mean() > 0.5


def test_terrain_of_rocks_started_again_is_not_called_clear(scene):
    mapper = look(scene, 0.1 * np.arange(4))
    assert mapper.hazard_map().observed.any()
    mapper.tracker.renew()
    off = replace(scene[0], mount=np.diag([1.0, -1.0, -1.0]) @ scene[0].mount)  # looks at the sky
    see(mapper, off, np.tile(np.arange(640, dtype=np.uint8), (480, 1)), 2.0)
    assert not mapper.hazard_map().observed.any()


def turned(angle):
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ SUN


def evidence(mapper):
    """All that pictures change: what is seen, rocks, and the lander's state."""
    f = mapper.tracker.filter
    return [
        mapper.probability.observed, mapper.probability.probability(mapper.tracker), f.covariance,
        f.xyz, f.radius, f.inertial.position, mapper.tracker.existence,
    ]  # fmt: skip


def test_images_that_fail_add_nothing_seen_no_rock_and_no_measurement(scene):
    rng = np.random.default_rng(3)
    for name, counts in all_faults(scene[1][0], rng).items():
        fresh = look(scene, [0.0, 0.1, 0.2], counts=counts)
        assert not fresh.probability.observed.any(), name
        assert not fresh.hazard_map().observed.any(), name
        assert fresh.tracker.filter.count == 0, name
        assert fresh.is_empty and fresh.rejected_images.total() == 3, name
        assert fresh.tracker.filter.events[0].name == "image-rejected", name
    mapper = look(scene, [0.0, 0.1, 0.2])
    before = [value.copy() for value in evidence(mapper)]
    for k, counts in enumerate(all_faults(scene[1][0], rng).values()):
        see(mapper, scene[0], counts, 0.3 + 0.1 * k)
    assert all(np.array_equal(a, b) for a, b in zip(before, evidence(mapper), strict=True))
    see(mapper, scene[0], scene[1][3], 9.0)
    last = mapper.tracker.filter.events[-1]
    assert (last.name, last.details["rejected_images"]) == (
        "image-accepted",
        mapper.rejected_images.total(),
    )


@pytest.mark.parametrize("turn", [30.0, -30.0, 180.0])
def test_a_sun_elsewhere_adds_nothing_from_the_first_image_on(scene, turn):
    mapper = look(scene, 0.1 * np.arange(4), turned(turn))
    assert not mapper.probability.observed.any()
    assert mapper.tracker.filter.count == 0


def test_frames_that_are_stuck_add_nothing_though_the_lander_moves_on(scene):
    mapper = look(scene, [0.0])
    seen = mapper.probability.observed.copy()
    assert seen.any()
    for k in range(4):
        mapper.tracker.filter.inertial.position[:2] += 8.0
        see(mapper, scene[0], scene[1][0], 0.1 + 0.1 * k)
    assert np.array_equal(mapper.probability.observed, seen)
    assert mapper.rejected_images.total() == 4


@pytest.mark.parametrize("honest_looks", [4, 9])
def test_images_of_elsewhere_add_nothing_though_no_two_are_alike(scene, honest_looks):
    """Frames that come late, again or from another's memory show other rocks than are there."""
    mapper = look(scene, 0.1 * np.arange(honest_looks))
    before = mapper.probability.observed.copy()
    rng = np.random.default_rng(4)
    for k in range(3):
        again = scene[1][k] + rng.integers(-2, 3, scene[1][k].shape)
        mapper.tracker.filter.inertial.position[:2] += (3.0, -2.0)
        see(mapper, scene[0], again.clip(0, 255).astype(np.uint8), 2.0 + 0.3 * k)
    assert mapper.rejected_images[ImageRejection.MISPLACED] == 3
    assert not (mapper.probability.observed & ~before).any()
    assert mapper.tracker.filter.events[-1].details["reason"] == ImageRejection.MISPLACED.value


def test_what_was_looked_at_under_a_sun_that_is_no_longer_believed_is_not_seen(scene):
    mapper = look(scene, 0.1 * np.arange(4))
    assert mapper.probability.observed.any()
    mapper.sun = turned(180.0)
    see(mapper, scene[0], scene[1][4], 0.5)
    assert mapper.rejected_images[ImageRejection.SUN_ELSEWHERE] == 1
    assert not mapper.probability.observed.any()


def test_a_pose_that_is_none_adds_nothing(scene):
    mapper = look(scene, [])
    rocks = mapper.tracker.filter
    good = rocks.inertial.estimate(rocks.covariance, 0.0, 1.0)
    for k, bad in enumerate((
        replace(good, position=np.array([np.nan, 0.0, 50.0])),
        replace(good, attitude=1.5 * good.attitude),
    )):  # fmt: skip
        mapper.update(CameraImage(0.1 * k, scene[1][k], scene[0]), bad)
    assert mapper.rejected_images.total() == 2
    assert not mapper.probability.observed.any()
    assert mapper.tracker.filter.count == 0


@pytest.mark.parametrize("elevation", [90.0, -10.0, 35.0])
def test_a_sun_at_another_height_than_the_models_is_refused(elevation):
    e = np.radians(elevation)
    mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), MODEL)
    with pytest.raises(InputError, match="sun"):
        ShadowMapper(tracker_at(PLACE), mapping, np.array([np.cos(e), 0.0, np.sin(e)]), 1.0)


def test_a_map_on_which_no_rock_is_found_says_so(scene):
    mapper = look(scene, 0.1 * np.arange(4))
    assert mapper.hazard_map().in_domain is None
    assert not {"too-few-rocks", "no-hazard-found"} & {e.name for e in mapper.tracker.filter.events}
    mapper.tracker.existence[:] = 1e-3
    see(mapper, scene[0], scene[1][4], 2.0)
    mapper.tracker.existence[:] = 1e-3
    drawn = mapper.hazard_map()
    assert drawn.observed.any() and not drawn.in_domain.any()
    event = mapper.tracker.filter.events[-1]
    assert event.name == "too-few-rocks"
    assert event.details["rocks"] == 0 and event.details["expected"] > 10.0


def test_a_map_that_calls_all_safe_says_so_and_what_follows_too(scene, monkeypatch):
    mapper = look(scene, [])
    probability = mapper.probability
    draw = probability.hazard_map

    def safe(*args):
        drawn = draw(*args)
        return replace(drawn, p_safe=np.full_like(drawn.p_safe, 0.999))

    monkeypatch.setattr(probability, "hazard_map", safe)
    few = []
    monkeypatch.setattr(
        "lunarsim.onboard.hazards.shadows.mapper.is_rock_count_too_low",
        lambda found, expected: bool(few),
    )
    names = []
    for k in range(4):
        see(mapper, scene[0], scene[1][k], 1.5 * k)
        if k == 2:
            few.append(True)
        mapper.hazard_map()
        names = [
            e.name
            for e in mapper.tracker.filter.events
            if e.name.endswith(("hazard-found", "rocks"))
        ]
        assert (
            names
            == [
                ["no-hazard-found"],
                ["no-hazard-found"],
                *2 * [["no-hazard-found", "too-few-rocks"]],
            ][k]
        )


@pytest.mark.parametrize("forgotten", [False, True])
def test_what_was_seen_moves_with_the_lander_as_an_image_corrects_it(scene, monkeypatch, forgotten):
    """What corrects the lander moves the rocks; what was seen, and is seen now, goes with them."""
    mapper = look(scene, 0.1 * np.arange(4))
    before = mapper.probability.observed
    assert 0.1 < before.mean() < 0.99
    rocks, update = mapper.tracker.filter, mapper.tracker.update

    def corrected(*args):
        found = update(*args)
        error = np.zeros(15)
        error[:2] = [2.0, -1.0]
        rocks.inertial.correct(error)
        rocks.xyz[:, :2] += error[:2]
        return found

    monkeypatch.setattr(mapper.tracker, "update", corrected)
    if forgotten:
        # Of what was seen only this picture is left.
        mapper.probability.forget()
    see(mapper, scene[0], scene[1][4], 0.4)
    after = mapper.probability.observed
    # Cells are half a metre wide: four columns east, two rows south.
    off = np.mean(after[:-2, 4:] != before[2:, :-4])
    assert off < 0.5 * np.mean(after != before)


def test_rocks_started_again_do_not_report_any_motion(scene, monkeypatch):
    """They stand elsewhere since another picture tells where, not since the ground moved."""
    mapper, motions = look(scene, [0.0]), []
    moved = mapper.tracker.moved
    monkeypatch.setattr(mapper.tracker, "moved", lambda: motions.append(moved()) or motions[-1])
    see(mapper, scene[0], scene[1][1], 0.1)
    twice = mapper.tracker.hits == 2
    assert np.count_nonzero(twice) > 10
    assert np.isnan(motions[0][1][twice]).mean() > 0.8


def test_a_plane_in_its_own_shadow_shows_nothing():
    """Lit ground that was measured to lie so is elsewhere, or otherwise: nothing is seen of it."""
    sun = direction_from_angles(1.2, np.radians(14.0))
    state, camera, counts = picture(rocks_on_a_plane("hemisphere"), PLACE, (1.2, 14.0))
    tracker = tracker_at(PLACE, model=ShadowModel(np.radians(14.0)))
    mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), tracker.model)
    rise = 0.27 * sun[:2] / np.hypot(*sun[:2])
    mapper = ShadowMapper(tracker, mapping, sun, 1.0, terrain_mapper=Slope(rise))
    see(mapper, camera.model, counts, 0.0)
    assert mapper.rejected_images == {ImageRejection.NO_SHADOWS: 1}
    assert not mapper.hazard_map().observed.any()


def checked_undetected_probability(mapper):
    """Return `unseen` of what is published, which is what would be worked out anew."""
    unseen = mapper.evidence().undetected_probability
    anew = mapper.probability.untracked_rock_probability(mapper.footprint).astype(np.float32)
    np.testing.assert_array_equal(unseen, anew)
    np.testing.assert_array_equal(unseen, mapper.evidence().undetected_probability)
    return unseen.copy()


def test_rocks_that_are_not_tracked_are_reported_as_they_would_be_again(scene):
    camera, honest = scene
    mapper = look(scene, [0.0])
    first = checked_undetected_probability(mapper)
    assert first.min() < 0.5 * first.max()
    # Rocks that are tracked are none of them.
    assert mapper.tracker.filter.count > 10
    # Sharper looks were taken since, two at the same time, and the map is not due yet.
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    for height, time in ((40.0, 0.3), (32.0, 0.3)):
        _, eye, counts = picture(terrain, (0.0, 0.0, height))
        mapper.tracker.filter.inertial.position[:] = [0.0, 0.0, height]
        see(mapper, eye.model, counts, time)
        assert not np.array_equal(checked_undetected_probability(mapper), first)
        first = checked_undetected_probability(mapper)
    # The map is due; rocks were moved since the picture, and what was seen goes with them.
    mapper.tracker.filter.inertial.position[:] = [0.0, 0.0, 50.0]
    see(mapper, camera, honest[3], 1.5)
    mapper.tracker.filter.xyz[:, :2] += [3.0, -2.0]
    checked_undetected_probability(mapper)
    mapper.recentre(np.array([15.0, 0.0, 0.0]))
    assert not np.array_equal(checked_undetected_probability(mapper), first)
    # Rocks were let go, and with them what was seen; the map is not due yet.
    mapper.tracker.renew()
    assert np.ptp(checked_undetected_probability(mapper)) == 0.0


def test_rocks_give_the_uncertainty_of_the_height_unless_it_was_measured(scene, monkeypatch):
    camera, honest = scene
    calls = []

    def nothing_is_known(rocks, xy):
        calls.append(rocks)
        return np.full(len(xy), np.inf)

    monkeypatch.setattr("lunarsim.onboard.hazards.shadows.mapper.height_sigma", nothing_is_known)
    alone = look(scene, [0.0])
    assert calls == [alone.tracker.filter]
    assert not alone.probability.evidence.lit.any()
    mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), MODEL, HazardPrior(0.05, 0.5))
    informed = ShadowMapper(tracker_at(PLACE), mapping, SUN, 1.0, terrain_mapper=Slope((0.0, 0.0)))
    see(informed, camera, honest[0], 0.0)
    assert informed.probability.evidence.lit.any()


def test_places_need_not_be_known_better_than_the_least_rock_is_large(scene, monkeypatch):
    radii = []

    def recorded_position_sigma(rocks, xy, enough):
        radii.append(enough)
        return np.full(len(xy), 0.01)

    monkeypatch.setattr(
        "lunarsim.onboard.hazards.shadows.mapper.position_sigma", recorded_position_sigma
    )
    mapper = look(scene, [0.0])
    assert radii == [mapper.tracker.settings.min_radius]
    assert mapper.probability.observed.any()


def test_cells_of_an_image_are_as_large_on_the_terrain_as_their_corners_say(monkeypatch):
    """Seen aslant; by the shoelace formula, and by the length of a shadow of 1 m of radius."""
    place = (-30.0, 20.0, 40.0)
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    state, camera, counts = picture(terrain, place)
    found = []

    def recorded_blind_regions(counts, seen, sharpness, area, cover):
        found.extend((sharpness, area, cover))
        return np.zeros(counts.shape, bool)

    monkeypatch.setattr(
        "lunarsim.onboard.hazards.shadows.mapper.blind_regions", recorded_blind_regions
    )
    mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), MODEL, HazardPrior(0.07, 0.5))
    mapper = ShadowMapper(tracker_at(place), mapping, SUN, 1.0)
    see(mapper, camera.model, counts, 0.0)
    view = camera.model.view(state)
    corners = cell_centres(640, 480)[:, None] + 20.0 * np.array(
        [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    )
    rays = np.dstack(((corners - [view.cx, view.cy]) / [view.fx, view.fy], np.ones((192, 4))))
    rays = rays @ view.enu_to_sensor
    ground = view.position[:2] - rays[..., :2] / rays[..., 2:] * view.position[2]
    after = np.roll(ground, -1, axis=1)
    cross = ground[..., 0] * after[..., 1] - ground[..., 1] * after[..., 0]
    sharpness, area, cover = found
    np.testing.assert_allclose(area, 0.5 * np.abs(cross.sum(1)), rtol=0.03)
    assert cover == 0.07
    away = np.linalg.norm(ground.mean(1) - view.position[:2], axis=1)
    # Farther off shadows are smaller.
    assert np.corrcoef(sharpness, away)[0, 1] < -0.8


def test_a_map_counts_the_point_spread_that_its_camera_is_evaluated_by(scene):
    """A camera of 0.7 pixels and one of 0.6, as its pictures are: the same looks, less sharp."""
    camera, honest = scene
    sharpest = {}
    for blur in (0.6, 0.7):
        mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), MODEL, HazardPrior(0.05, 0.5))
        health = ImageQualityCheck(blur)
        mapper = ShadowMapper(tracker_at(PLACE), mapping, SUN, 1.0, health=health)
        see(mapper, camera, honest[0], 0.0)
        assert not mapper.rejected_images
        sharpest[blur] = mapping.evidence.lit.max()
    wider = np.hypot(0.7, 12.0**-0.5) / np.hypot(0.6, 12.0**-0.5)
    assert sharpest[0.6] / sharpest[0.7] == pytest.approx(wider, rel=1e-3)
