"""What is noise of a look, and what lasts, in how rocks are tracked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.shadows import TrackerSettings
from lunarsim.onboard.perception.detector import detect_rocks
from tests.shadow_scene import MODEL, SUN, at, follow, picture, rocks_on_a_plane, tracker_at


def twice(change, pictures=3, **settings):
    """Follow the same rocks by pictures as they are, and as changed; return both trackers."""
    terrain = rocks_on_a_plane("hemisphere", seed=5, count=40)
    out = []
    for changed in (False, True):
        tracker = tracker_at((-30.0, 0.0, 60.0), **settings)
        outcomes = []
        for k in range(pictures):
            state, camera, counts = picture(terrain, (-30.0 + k, 0.0, 60.0))
            error = np.zeros(15)
            error[:3] = state.position - tracker.filter.inertial.position
            tracker.filter.inertial.correct(error)
            seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
            if changed:
                seen = change(seen, k)
            outcomes.append(tracker.update(seen, camera, SUN, 0.1 * k))
        out.append((tracker, outcomes))
    return out


def test_what_lasts_from_observation_to_observation_is_no_noise_of_the_filter():
    """What a shape may be off by decides what is paired, not how rocks are begun or corrected."""

    def more(seen, _):
        return replace(seen, pixel_covariance=1.1 * seen.pixel_covariance)

    (one, found), (other, same) = twice(more)
    assert one.filter.count > 10 and found[-1].dof > 20
    assert [o.nis for o in found] == [o.nis for o in same]
    assert np.array_equal(one.filter.covariance, other.filter.covariance)

    def noisier(seen, _):
        return replace(seen, independent_covariance=1.1 * seen.independent_covariance)

    (one, found), (other, same) = twice(noisier)
    assert same[-1].nis < found[-1].nis
    grown = np.diagonal(other.filter.rock_covariance() - one.filter.rock_covariance(), 0, 1, 2)
    assert (grown[:, :2] > 0.0).all()


def test_a_rock_stands_where_its_second_observation_shows_it():
    """The first was chosen for being good, and errs by that: it is forgotten, place and size."""
    terrain = rocks_on_a_plane("hemisphere", seed=5, count=40)
    tracker = tracker_at((-30.0, 0.0, 60.0))
    for k, shift in enumerate(([0.2, -0.2], [0.0, 0.0], [0.1, 0.0])):
        state, camera, counts = picture(terrain, (-30.0, 0.0, 60.0))
        seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
        bigger = 1.1 if k == 0 else 1.0
        given = replace(seen, pixel=seen.pixel + shift, radius=bigger * seen.radius)
        outcome = tracker.update(given, camera, SUN, 0.1 * k)
        rocks = tracker.filter
        off = np.linalg.norm(rocks.xy[:, None] - seen.terrain_xy, axis=-1)
        if k == 0:
            first = rocks.count
        if k == 1:
            assert rocks.count == first > 10
            assert off.min(axis=1).max() < 1e-9
            assert rocks.radius == pytest.approx(seen.radius[off.argmin(axis=1)])
            assert outcome.dof == 0, "it tells nothing of the lander"
            sigma = rocks.rock_covariance()
        if k == 2:
            assert outcome.dof == 2 * rocks.count
            assert (np.diagonal(rocks.rock_covariance() - sigma, 0, 1, 2)[:, :2] < 0.0).all()


@pytest.mark.parametrize("share", [np.nan, np.inf, 0.0, -1.0, 1e12])
def test_a_second_observation_with_a_zero_or_infinite_covariance_changes_nothing(share):
    def broken(seen, k):
        look = seen.independent_covariance.copy()
        if k == 1:
            look[::2] *= share
        return replace(seen, independent_covariance=look)

    (one, _), (other, found) = twice(broken)
    assert np.isfinite(other.filter.covariance).all() and np.isfinite(other.filter.xyz).all()
    # Half of the rocks are begun anew an image later.
    assert other.filter.count == one.filter.count
    assert 0 < found[-1].dof < 0.6 * 2 * one.filter.count
    assert found[-1].is_accepted


@pytest.mark.parametrize("broken", [np.diag([1.0, -1.0]), np.diag([-1.0, -1.0]), np.zeros((2, 2))])
def test_a_first_observation_without_a_covariance_starts_no_rock(broken):
    def change(seen, k):
        look = seen.independent_covariance.copy()
        if k == 0:
            look[::2] = 0.02 * broken
        return replace(seen, independent_covariance=look)

    terrain = rocks_on_a_plane("hemisphere", seed=5, count=40)
    state, camera, counts = picture(terrain, (-30.0, 0.0, 60.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    sound, tracker = tracker_at((-30.0, 0.0, 60.0)), tracker_at((-30.0, 0.0, 60.0))
    sound.update(seen, camera, SUN, 0.0)
    tracker.update(change(seen, 0), camera, SUN, 0.0)
    assert 0 < tracker.filter.count < 0.7 * sound.filter.count
    assert np.linalg.eigvalsh(tracker.filter.rock_covariance()[:, :2, :2]).min() > 0.0


def test_whoever_was_seen_once_is_remembered_when_rocks_go():
    terrain = rocks_on_a_plane("hemisphere", seed=5, count=40)
    tracker = tracker_at((-30.0, 0.0, 60.0))
    state, camera, counts = picture(terrain, (-30.0, 0.0, 60.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    hidden = seen.pixel.copy()
    hidden[::2] = np.nan
    tracker.update(replace(seen, pixel=hidden), camera, SUN, 0.0)
    old = tracker.filter.count
    # The first of those is none; the last of those that come now takes its place.
    tracker.existence[0] = 1e-6
    tracker.update(seen, camera, SUN, 0.1)
    assert tracker.filter.count > old
    outcome = tracker.update(seen, camera, SUN, 0.2)
    assert outcome.dof == 2 * (old - 1)


def test_a_pair_that_is_off_beside_the_others_is_left_out():
    def shift(seen, k):
        pixel = seen.pixel.copy()
        if k == 2:
            pixel[3] += [1.6, 0.0]
        return replace(seen, pixel=pixel)

    (_, found), (_, shifted) = twice(shift)
    assert shifted[-1].is_accepted
    assert shifted[-1].dof == found[-1].dof - 2


def test_an_error_that_an_image_shares_counts_as_much_as_configured():
    def shift(seen, k):
        return replace(seen, pixel=seen.pixel + [0.4, -0.3]) if k == 2 else seen

    _, (_, alone) = twice(shift, common_pixels=0.0)
    _, (_, shared) = twice(shift, common_pixels=3.0)
    assert shared[-1].dof == alone[-1].dof > 20
    assert shared[-1].nis < 0.5 * alone[-1].nis


def wandered(**settings):
    """Return how rocks' places err more once the lander has moved and nothing was seen there.

    That is the growth of their covariance (n, 2, n, 2) along the Sun and across, m^2, and their
    ranges before and after (n,), m, and what a pixel spans at 1 m, m.
    """
    terrain = rocks_on_a_plane("hemisphere", seed=5, count=40)
    start = (-30.0, 0.0, 60.0)
    tracker = follow(terrain, [start], tracker_at(start, **settings))
    rocks, first = tracker.filter, tracker.filter.first

    def covariance():
        return rocks.covariance[first:, first:].reshape(rocks.count, 3, rocks.count, 3).copy()

    before, far = covariance(), np.linalg.norm(rocks.xyz - rocks.inertial.position, axis=1)
    error = np.zeros(15)
    error[:3] = [20.0, 15.0, 0.0]
    rocks.inertial.correct(error)
    # A picture in which nothing is dark.
    state, camera = at(rocks.inertial.position)
    bright = np.full((camera.height, camera.width), 120, np.uint8)
    tracker.update(detect_rocks(bright, camera, state, SUN, model=MODEL), camera, SUN, 0.1)
    level = SUN[:2] / np.hypot(*SUN[:2])
    axes = np.array([level, [-level[1], level[0]]])
    more = (covariance() - before)[:, :2, :, :2]
    near = np.linalg.norm(rocks.xyz - rocks.inertial.position, axis=1)
    pixel = 1.0 / np.sqrt(camera.fx * camera.fy)
    return np.einsum("ai,minj,bj->manb", axes, more, axes), far, near, pixel


@pytest.mark.parametrize(("wander", "axis"), [((0.5, 0.0, 0.0), 0), ((0.0, 0.5, 0.0), 1)])
def test_centres_wander_along_the_sun_and_across_as_each_is_given(wander, axis):
    more, *_ = wandered(view_wander=wander, range_wander=0.0)
    grown = np.einsum("mama->ma", more)
    assert (grown[:, axis] > 1e-4).all()
    assert np.abs(grown[:, 1 - axis]).max() < 1e-12


def test_centres_wander_together_along_the_sun_as_the_lander_draws_near():
    more, far, near, pixel = wandered(view_wander=(0.0, 0.0, 0.0), range_wander=0.5)
    sigma = 0.5 * pixel * near * np.sqrt(np.abs(np.log(near / far)))
    assert sigma.max() > 2.0 * sigma.min() > 0.0
    np.testing.assert_allclose(more[:, 0, :, 0], np.outer(sigma, sigma), rtol=1e-9, atol=1e-12)
    more[:, 0, :, 0] = 0.0
    assert np.abs(more).max() < 1e-12


@pytest.mark.parametrize(
    "given", [{"view_wander": 0.2}, {"view_wander": (0.2, 0.1, np.nan)},
              {"view_wander": (0.2, -0.1, 0.2)}, {"common_pixels": np.nan},
              {"range_wander": -0.1}, {"range_wander": np.nan}, {"min_birth_q": np.nan},
              {"max_birth_sigma": -1.0}, {"radius_floor": np.nan},
              {"max_normalised_innovation": np.nan},
              {"min_expected_rocks": np.nan}, {"min_found_fraction": 1.5},
              {"max_full_update_rocks": -1}, {"max_rocks": -1},
              {"max_position_updates": -1}, {"region": (1.0, -1.0, 0.0, 2.0)},
              {"region": (0.0, 1.0, 0.0, np.nan)}, {"region": (0.0, 1.0)}, {"region": 3.0}],
)  # fmt: skip
def test_shares_that_cannot_be_are_refused(given):
    with pytest.raises(InputError, match=r"tracker\."):
        TrackerSettings(**given)


def test_a_rock_is_started_where_its_place_shows_well_though_its_shape_is_not_known():
    def vague(seen, _):
        return replace(seen, pixel_covariance=seen.pixel_covariance + 25.0 * np.eye(2))

    (one, _), (other, _) = twice(vague)
    assert other.filter.count == one.filter.count > 10

    def blurred(seen, _):
        return replace(seen, independent_covariance=seen.independent_covariance + 25.0 * np.eye(2))

    (_, _), (none, _) = twice(blurred)
    assert none.filter.count == 0


@pytest.mark.parametrize(
    ("sun", "time", "match"),
    [([0.0, 0.0, 1.0], 0.0, "sun"), ([np.nan, 0.0, 1.0], 0.0, "sun"), (SUN, np.inf, "time")],
)
def test_a_sun_without_shadows_and_times_that_are_none_are_refused(sun, time, match):
    state, camera, counts = picture(rocks_on_a_plane("hemisphere", seed=5, count=40), (-30, 0, 60))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    with pytest.raises(InputError, match=match):
        tracker_at((-30.0, 0.0, 60.0)).update(seen, camera, sun, time)


def test_a_pair_that_is_off_by_other_than_the_rest_corrects_nothing():
    """Where the lander leans all rocks of a picture are off alike: one that is not is wrong."""
    terrain = rocks_on_a_plane("hemisphere", seed=5, count=40)
    state, camera, counts = picture(terrain, (-30.0, 0.0, 60.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    degrees = []
    for off in (0.0, 2.5):
        tracker = tracker_at((-30.0, 0.0, 60.0))
        for k in range(2):
            tracker.update(seen, camera, SUN, 0.1 * k)
        tracker.filter.state.add_process_noise(np.arange(9, 12), 0.02**2 * np.eye(3))
        pixel = seen.pixel + [3.0, 2.0]
        pixel[:3] += [off, -off]
        degrees.append(tracker.update(replace(seen, pixel=pixel), camera, SUN, 0.2).dof)
    assert degrees[0] > 40
    assert degrees[1] == degrees[0] - 6


def test_rocks_that_have_waited_longest_are_corrected_first():
    (tracker, found), _ = twice(lambda seen, k: seen, max_position_updates=12, pictures=6)
    assert [outcome.dof for outcome in found[2:]] == [24] * 4
    # Some 30 rocks in turn, 12 a picture: nobody waits for more than three.
    seen = tracker.hits >= 6
    assert seen.sum() > 24
    assert tracker.corrected[seen].min() >= 0.3 - 1e-9
