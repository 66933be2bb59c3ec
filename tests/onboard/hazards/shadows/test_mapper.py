"""The mapper where pictures or the Sun are not what they should be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.measurements import Picture
from lunarsim.onboard.hazards.shadows import ProbabilityMap, ShadowMapper
from tests.shadow_scene import MODEL, SUN, picture, rocks_on_a_plane, tracker_at

PLACE = (0.0, 0.0, 50.0)


@pytest.fixture(scope="module")
def scene():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    _, camera, counts = picture(terrain, PLACE)
    return camera.model, counts


def look(scene, times, sun=SUN, counts=None):
    camera, honest = scene
    tracker = tracker_at(PLACE)
    mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), MODEL)
    mapper = ShadowMapper(tracker, mapping, sun, 1.0)
    for time in times:
        see(mapper, camera, honest if counts is None else counts, time)
    return mapper


def see(mapper, camera, counts, time):
    rocks = mapper.tracker.filter
    estimate = rocks.inertial.estimate(rocks.covariance, time, 1.0)
    mapper.update(Picture(time, counts, camera), estimate)


@pytest.mark.parametrize("level", [0, 255])
def test_black_and_white_pictures_clear_nothing(scene, level):
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
    assert not mapper.tracker.filter.events


def test_pictures_do_not_run_backwards(scene):
    mapper = look(scene, [0.0, 1.0])
    for time in (0.9, np.nan):
        with pytest.raises(InputError, match=r"picture\.time"):
            see(mapper, scene[0], scene[1], time)


@pytest.mark.parametrize("turn", [45.0, 180.0])
def test_a_sun_that_stands_elsewhere_is_noticed_and_the_map_claims_nothing(scene, turn):
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    wrong = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ SUN
    mapper = look(scene, 0.5 * np.arange(8), wrong)
    rocks = mapper.tracker.filter
    assert rocks.lost
    assert ("lost", "rocks' shadows") in [(e.name, e.details["measurement"]) for e in rocks.events]
    assert not mapper.hazard_map().observed.any()


def test_the_sun_where_it_is_raises_no_doubt(scene):
    mapper = look(scene, 0.5 * np.arange(12))
    assert not mapper.tracker.filter.lost
    assert mapper.tracker.filter.pictures.watches["shadows"].degrees >= 10
    assert mapper.hazard_map().observed.mean() > 0.5


def test_ground_of_rocks_begun_anew_is_not_called_clear(scene):
    mapper = look(scene, 0.1 * np.arange(4))
    assert mapper.hazard_map().observed.any()
    mapper.tracker.renew()
    off = replace(scene[0], mount=np.diag([1.0, -1.0, -1.0]) @ scene[0].mount)  # looks at the sky
    see(mapper, off, np.tile(np.arange(640, dtype=np.uint8), (480, 1)), 2.0)
    assert not mapper.hazard_map().observed.any()
