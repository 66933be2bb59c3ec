from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lunarsim.errors import InputError
from lunarsim.frames import direction_from_angles
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.world.terrain import Terrain
from tests.shadow_scene import MODEL, SUN, at, follow, picture, rocks_on_a_plane, tracker_at
from tests.worlds import flat_terrain


def test_rocks_are_tracked_once_each_and_their_places_sharpen():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    path = [(-30.0 + 3.0 * k, 10.0, 90.0 - 3.0 * k) for k in range(15)]
    tracker = follow(terrain, path, tracker_at(path[0]))
    true = np.column_stack((terrain.rocks.x, terrain.rocks.y))
    distance, nearest = cKDTree(true).query(tracker.filter.xy)
    good = distance < 0.5 * terrain.rocks.a[nearest]
    assert good.mean() > 0.85
    # Few doubles.
    assert len(np.unique(nearest[good])) > 0.95 * good.sum()
    assert np.median(distance[good]) < 0.15
    ratio = tracker.filter.radius[good] / terrain.rocks.a[nearest[good]]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    assert np.median(tracker.existence[good]) > 0.99


def test_a_cluster_seen_as_one_is_split_when_it_is_resolved():
    tracker = tracker_at((0.0, 0.0, 60.0))
    state, camera = at((0.0, 0.0, 60.0))
    tracker.add_known([[0.0, 0.0]], 0.3, 2.0, 0.5)
    rocks = RockField.hemispheres([-1.1, 1.1], [0.4, -0.4], 0.0, 0.6)
    pair = Terrain(flat_terrain(400.0, 10.0).relief, rocks)
    state, camera, counts = picture(pair, (0.0, 0.0, 60.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    assert len(seen) == 2
    tracker.update(seen, camera, SUN, 0.0)
    assert tracker.filter.count == 2
    assert np.sort(tracker.filter.xy[:, 0]) == pytest.approx([-1.1, 1.1], abs=0.25)
    # One look is one look: it began them, and tells no more of them.
    assert tracker.hits.tolist() == [1, 1]
    probability = 1.0 - tracker.rates.false_positive(seen.q)
    assert np.sort(tracker.existence) == pytest.approx(np.sort(np.clip(probability, 0.1, 0.99)))
    assert tracker.update(seen, camera, SUN, 0.1).dof == 0, "the second begins them anew"
    assert tracker.update(seen, camera, SUN, 0.2).dof == 4


def test_doubles_are_merged_and_ghosts_pruned():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=30, size=60.0)
    big = int(np.argmax(terrain.rocks.a))
    place = np.array([terrain.rocks.x[big], terrain.rocks.y[big]])
    tracker = tracker_at((0.0, 0.0, 50.0))
    # The same rock twice, and one where there is none.
    ghost = np.array([3.0, -2.0])
    away = np.hypot(*(np.column_stack((terrain.rocks.x, terrain.rocks.y)) - ghost).T)
    assert away.min() > 1.5
    tracker.add_known([place, place + 0.2, ghost], 0.05, [1.0, 1.0, 1.0], 0.2)
    follow(terrain, [(0.0, 0.0, 50.0)] * 25, tracker)
    near = np.hypot(*(tracker.filter.xy - place).T) < 1.0
    assert near.sum() == 1
    assert np.hypot(*(tracker.filter.xy - ghost).T).min() > 0.8


def test_known_rocks_must_be_numbers():
    with pytest.raises(InputError, match=r"sigma\[0\]: must be positive and finite"):
        tracker_at((0.0, 0.0, 50.0)).add_known([[0.0, 0.0]], -1.0, 1.0, 0.1)


def test_most_rocks_is_a_limit():
    terrain = rocks_on_a_plane("hemisphere", seed=11)
    tracker = follow(terrain, [(0.0, 0.0, 60.0)] * 2, tracker_at((0.0, 0.0, 60.0), max_rocks=7))
    assert tracker.filter.count <= 7
    assert len(tracker.tentative.xy) > 0


def test_what_is_seen_above_the_horizon_has_no_place():
    terrain = rocks_on_a_plane("hemisphere", seed=11)
    tracker = follow(terrain, [(0.0, 0.0, 60.0)] * 2, tracker_at((0.0, 0.0, 60.0), max_rocks=7))
    state, camera, counts = picture(terrain, (0.0, 0.0, 60.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    ahead = gimbal_mount(state.attitude, np.array([1.0, 0.0, 0.0]))
    camera = dataclasses.replace(camera, mount=ahead)
    on_ground = np.isfinite(tracker.filter.terrain_points(camera, seen.pixel)).all(1)
    assert on_ground.any() and not on_ground.all()
    tracker.update(seen, camera, SUN, 1.0)
    assert 0 < len(tracker.tentative.xy) <= on_ground.sum()
    for name in ("xy", "sigma", "radius", "radius_variance", "existence"):
        assert np.isfinite(getattr(tracker.tentative, name)).all(), name


def test_rocks_out_of_view_rest_in_large_maps():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    high, low = (1.0, 0.0, 70.0), (1.0, 0.0, 20.0)  # the camera looks at the middle
    moved = {}
    for above in (0, 1000):
        tracker = follow(terrain, [high] * 6, tracker_at(high, max_full_update_rocks=above))
        before = tracker.filter.xy.copy()
        follow(terrain, [low] * 2, tracker, begins=1.0)
        away = np.array([(np.abs(tracker.filter.xy - xy).max(1) > 0.0).all() for xy in before])
        moved[above] = away.mean()
    assert moved[0] < 0.3
    assert moved[1000] > 0.9


def test_radii_of_all_rocks_seen_are_corrected():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    path = [(0.0, 0.0, 60.0)] * 8
    few, all_of_them = (
        follow(terrain, path, tracker_at(path[0], max_position_updates=n)) for n in (1, 1000)
    )
    assert few.filter.count == all_of_them.filter.count > 20
    assert few.filter.radius_variance == pytest.approx(all_of_them.filter.radius_variance, rel=0.05)
    variances = [np.trace(t.filter.rock_covariance(), axis1=1, axis2=2) for t in (few, all_of_them)]
    assert np.median(variances[0]) > 2.0 * np.median(variances[1])


def test_images_do_not_run_backwards():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=20, size=40.0)
    tracker = follow(terrain, [(0.0, 0.0, 50.0)] * 3, tracker_at((0.0, 0.0, 50.0)))
    _, camera, counts = picture(terrain, (0.0, 0.0, 50.0))
    seen = detect_rocks(counts, camera, at((0.0, 0.0, 50.0))[0], SUN, model=MODEL)
    for time in (0.1, np.nan):
        with pytest.raises(InputError, match=r"image\.time"):
            tracker.update(seen, camera, SUN, time)


def nothing_like(seen):
    """Return detections of no rock in an image as large."""
    none = np.zeros(len(seen), bool)
    fields = {
        f.name: getattr(seen, f.name)[none]
        for f in dataclasses.fields(seen)
        if f.name not in {"labels", "excluded_labels", "largest", "relative",
        "relative_to_lit_terrain"}
    }  # fmt: skip
    return dataclasses.replace(seen, **fields, labels=np.zeros_like(seen.labels))


def test_an_image_without_rocks_moves_nothing_and_many_say_that_something_is_wrong():
    place = (0.0, 0.0, 50.0)
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    tracker = follow(terrain, [place] * 5, tracker_at(place))
    f, camera = tracker.filter, at(place)[1]
    xyz, count = f.xyz.copy(), f.count
    state, camera, counts = picture(terrain, place)
    empty = nothing_like(detect_rocks(counts, camera, state, SUN, model=MODEL))
    found = tracker.update(empty, camera, SUN, 0.5)
    assert (found.dof, f.count) == (0, count)
    assert np.array_equal(f.xyz, xyz)
    for k in range(12):
        tracker.update(empty, camera, SUN, 0.7 + 0.2 * k)
    names = [e.name for e in f.events]
    assert (
        names[0] == "covariance-inflated"
        and "rocks' expected" in f.events[0].details["measurement"]
    )


def test_rocks_that_cannot_be_explained_are_started_again():
    """The lander believes to be 4 m beside where it is: no rock is where it should be."""
    place = (0.0, 0.0, 50.0)
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    tracker = follow(terrain, [place] * 6, tracker_at(place))
    f = tracker.filter
    rows = f.state.p
    rows[:15], rows[:, :15] = 0.0, 0.0  # sure of being where it is not
    f.inertial.correct(np.eye(15)[0] * 4.0)
    state, camera, counts = picture(terrain, place)
    for k in range(20):
        believed = dataclasses.replace(state, position=f.inertial.position.copy())
        seen = detect_rocks(counts, camera, believed, SUN, model=MODEL)
        tracker.update(seen, camera, SUN, 1.0 + 0.1 * k)
    assert tracker.renewals >= 1
    assert "rocks-reset" in [e.name for e in f.events]
    true = np.column_stack((terrain.rocks.x, terrain.rocks.y))
    apart = cKDTree(true).query(f.xy + state.position[:2] - f.inertial.position[:2])[0]
    assert f.count > 20
    assert np.median(apart) < 0.3


def few_and_many(least, few):
    """Return the radii that a tracker begins with from one picture of rocks of many sizes."""
    place = (0.0, 0.0, 50.0)
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    state, camera, counts = picture(terrain, place)
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    tracker = tracker_at(place, min_radius=least, min_landmark_radius=0.3, min_rocks_in_view=few)
    tracker.update(seen, camera, SUN, 0.0)
    begun = tracker.filter.radius.copy()
    for k in range(3):
        tracker.update(seen, camera, SUN, 0.1 + 0.1 * k)
    return begun, tracker.filter.radius, tracker, seen


def test_small_rocks_are_landmarks_where_few_are_in_view():
    many, _, _, _ = few_and_many(0.8, 0)
    assert many.min() >= 0.8
    begun, kept, tracker, seen = few_and_many(0.8, 30)
    assert begun.min() < 0.6
    assert len(begun) > 1.5 * len(many)
    # Enough of them are in view by now for no more to begin, not for these to be let go.
    assert 30 <= len(kept) < 60
    assert kept.min() < 0.6
    # What a landmark's shadow hides is not explained by it.
    assert tracker.explained.any()
    assert seen.radius[tracker.explained].min() > 0.6
    tracker.settings = dataclasses.replace(tracker.settings, min_rocks_in_view=10)
    state, camera = at((0.0, 0.0, 50.0))
    tracker.update(seen, camera, SUN, 0.5)
    assert tracker.filter.radius.min() >= 0.85 * 0.8


@pytest.mark.parametrize("elevation", [5.0, 10.0])
def test_a_low_sun_begins_rocks_from_as_far_away_as_a_higher_one(elevation):
    """Looks are vague along the Sun alone then, and across no more than under 20 deg."""
    terrain, place = rocks_on_a_plane("cube", seed=3, count=40), (-20.0, 40.0, 150.0)
    begun = []
    for height in (20.0, elevation):
        sun = direction_from_angles(1.2, np.radians(height))
        state, camera, counts = picture(terrain, place, (1.2, height))
        seen = detect_rocks(
            counts, camera, state, sun, model=ShadowModel(np.radians(height), RockModel("cube"))
        )
        assert len(seen) > 25
        tracker = tracker_at(place)
        tracker.update(seen, camera, sun, 0.0)
        begun.append(tracker.filter.count / len(seen))
    assert begun[0] > 0.5
    assert begun[1] > 0.6 * begun[0]


@pytest.mark.parametrize(("elevation", "longer"), [(20.0, 1.0), (10.0, 2.064), (45.0, 1.0)])
def test_what_the_model_has_wrong_of_long_shadows_grows_with_them(elevation, longer, monkeypatch):
    tracker = tracker_at((0.0, 0.0, 60.0))
    given = []
    monkeypatch.setattr(
        tracker.filter,
        "add_view_noise",
        lambda sun, *wander, scale_sigma, pixel_size: given.append((*wander, scale_sigma)),
    )
    terrain, sun = flat_terrain(400.0, 10.0), direction_from_angles(1.2, np.radians(elevation))
    state, camera, counts = picture(terrain, (0.0, 0.0, 60.0), (1.2, elevation))
    tracker.update(detect_rocks(counts, camera, state, sun), camera, sun, 0.0)
    along, across, shared = tracker.settings.view_wander
    expected = (longer * along, across, longer * shared, longer * tracker.settings.range_wander)
    assert given == [pytest.approx(expected, rel=1e-3)]
