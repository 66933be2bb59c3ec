"""One map of two cameras, a wide one and a narrow one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.measurements import CameraImage
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap, ShadowMapper
from lunarsim.onboard.hazards.shadows.mapping import ShadowMapping
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.image_quality import (
    ImageQualityCheck,
    ImageRejection,
    SunConfirmation,
)
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rocks.field import RockModel
from lunarsim.sensors.camera import Camera
from lunarsim.world import World
from lunarsim.world.light import Light
from tests.shadow_scene import MODEL, SUN, at, rocks_on_a_plane, tracker_at

# 40 deg below the horizon, 1000 m up.
FAR = (-1000.0 / np.tan(np.radians(40.0)), 0.0, 1000.0)
NEAR = (0.0, 0.0, 50.0)
# The paper's resolution: a shadow of fewer pixels across is never found.
LEAST_Q = 1.13
CUBES = ShadowModel(np.radians(20.0), RockModel("cube", burial=(0.0, 0.0)))


def camera(place, degrees):
    state, mounted = at(place)
    return state, replace(Camera.with_field_of_view(640, 480, degrees), mount=mounted.mount)


@pytest.fixture(scope="module")
def world():
    terrain = rocks_on_a_plane("cube", seed=3, count=40, size=80.0)
    return World(terrain, 1.622, Light(1.2, np.radians(20.0)))


def found(world, place, degrees):
    """Return the share of rocks for which there is a detection, and q of a cube of 1 m."""
    state, eye = camera(place, degrees)
    counts = eye.expose(world, state, 0.0, np.random.default_rng(0)).counts
    seen = detect_rocks(counts, eye, state, SUN, model=MODEL)
    off = np.linalg.norm(seen.terrain_xy[:, None] - places_of(world.terrain), axis=2)
    pixel = np.linalg.norm(place) / eye.fx
    away = np.arctan2(place[0], place[1]) - 1.2
    q = CUBES.visible_q(0.5, away, np.radians(40.0), pixel)
    return float((off.min(0, initial=np.inf) < 1.0).mean()), float(q)


def places_of(terrain):
    return np.column_stack((terrain.rocks.x, terrain.rocks.y))


def test_from_1000_m_the_narrow_camera_finds_rocks_that_are_too_small_for_the_wide_one(world):
    wide, q_wide = found(world, FAR, 60.0)
    narrow, q_narrow = found(world, FAR, 10.0)
    assert q_wide < LEAST_Q < q_narrow
    assert wide < 0.1
    assert narrow > 0.6


def mapper_of(*names):
    grid = Grid.centred((0.0, 0.0), 40.0, 0.5)
    mapping = ProbabilityMap(grid, MODEL, HazardPrior(0.05, 0.5))
    sun = SunConfirmation()
    health = {name: ImageQualityCheck(sun=sun) for name in names}
    return ShadowMapper(tracker_at(NEAR), mapping, SUN, 1.0, health=health)


def look(mapper, sensor, eye, counts, time):
    rocks = mapper.tracker.filter
    estimate = rocks.inertial.estimate(rocks.covariance, time, 1.0)
    mapper.update_from_sensor(sensor, CameraImage(time, counts, eye), estimate)


@pytest.fixture(scope="module")
def frames():
    """Return a camera and five pictures of each of two, of rocks 50 m below."""
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    world = World(terrain, 1.622, Light(1.2, np.radians(20.0)))
    rng = np.random.default_rng(0)
    out = {}
    for name, degrees in (("wide", 60.0), ("narrow", 25.0)):
        state, eye = camera(NEAR, degrees)
        out[name] = eye.model, [eye.expose(world, state, 0.0, rng).counts for _ in range(5)]
    return out


def test_each_camera_is_compared_with_its_own_last_images(frames):
    """A buffer that stands still is seen, though another camera's pictures come between."""
    eye, pictures = frames["wide"]
    mapper = mapper_of("wide", "narrow")
    for k in range(5):
        look(mapper, "wide", eye, pictures[0], 0.2 * k)
        for n in range(2):
            look(mapper, "narrow", eye, pictures[(2 * k + n) % 4 + 1], 0.2 * k + 0.05 * (n + 1))
    assert mapper.rejected_images[ImageRejection.STUCK] == 4
    rejections = [e for e in mapper.tracker.filter.events if e.name == "image-rejected"]
    assert [e.details["camera"] for e in rejections] == ["wide"]
    # Each by itself is told of once, not at every change from one to the other.
    assert mapper.rejected_images.total() == 4


def test_both_cameras_see_rocks_where_they_are(frames):
    """Looks through pixels of two sizes agree: rocks stay where they are, as well as is claimed."""
    mapper = mapper_of("wide", "narrow")
    for k in range(5):
        for name in ("wide", "narrow"):
            look(mapper, name, frames[name][0], frames[name][1][k], 0.2 * k)
    f = mapper.tracker.filter
    assert mapper.rejected_images.total() == 0
    assert f.count > 15 and not f.lost
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    off = np.linalg.norm(f.xy[:, None] - places_of(terrain), axis=2)
    assert np.median(off.min(1)) < 0.25


def test_an_image_older_than_another_cameras_last_is_left_out(frames):
    mapper = mapper_of("wide", "narrow")
    look(mapper, "wide", *frames_at(frames, "wide", 0), 1.0)
    look(mapper, "narrow", *frames_at(frames, "narrow", 0), 0.5)
    (event,) = (e for e in mapper.tracker.filter.events if e.name == "out-of-order")
    assert event.details == {"sensor": "narrow", "stamp": 0.5, "last": 1.0}
    # Of one camera it is a mistake of the caller's, as ever.
    alone = mapper_of("wide")
    look(alone, "wide", *frames_at(frames, "wide", 0), 1.0)
    with pytest.raises(InputError, match=r"image\.time: must be at least the previous time"):
        look(alone, "wide", *frames_at(frames, "wide", 1), 0.5)


def frames_at(frames, name, k):
    eye, pictures = frames[name]
    return eye, pictures[k]


@pytest.mark.parametrize(
    ("settings", "field"),
    [({"sensors": ("a", "a")}, "sensors"), ({"sensor": "c", "sensors": ("a", "b")}, "sensor")],
)
def test_cameras_that_contradict_each_other_are_refused(settings, field):
    with pytest.raises(InputError) as error:
        ShadowMapping(**settings)
    assert error.value.field == field
