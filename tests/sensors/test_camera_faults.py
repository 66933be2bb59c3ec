"""Lens, shutter and exposure control of the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.rocks.field import RockField
from lunarsim.sensors.auto_exposure_camera import AutoExposureCamera
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.exposure_control import ExposureControl
from lunarsim.sensors.framing_camera import FramingCamera
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.light import Light
from lunarsim.world.terrain import Terrain
from tests.worlds import flat_terrain

GROUND = flat_terrain(400.0, 4.0)
CLEAN = Camera(
    160, 120, 140.0, 140.0, blur_sigma=0.0, shot_noise=False, read_noise=0.0, motion_blur=False,
    bits=16,
)  # fmt: skip


def state(height=50.0, rate=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), north=0.0):
    return State(
        np.array([0.0, north, height]), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        np.array(rate), 1000.0,
    )  # fmt: skip


def world(terrain=GROUND, **light):
    sun = {"azimuth": 1.0, "elevation": 0.6, "photometry": "lambert"}
    return World(terrain, 1.622, Light(**(sun | light)))


def counts(camera, seen=None, where=None, seed=0):
    rng = np.random.default_rng(seed)
    return camera.expose(seen or world(), where or state(), 0.0, rng).counts.astype(float)


def stones():
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-20.0, 20.0, (2, 40))
    return Terrain(GROUND.relief, RockField.hemispheres(x, y, 0.0, rng.uniform(0.5, 1.5, 40)))


def test_light_falls_off_with_the_fourth_power_of_the_cosine():
    even = counts(CLEAN)
    fallen = counts(replace(CLEAN, vignetting=4.0))
    v, u = np.indices(even.shape)
    cosine = np.cos(np.arctan(np.hypot(u - 79.5, v - 59.5) / 140.0))
    assert cosine.min() < 0.83
    assert np.allclose(fallen / even, cosine**4, atol=1e-3)


def test_stray_light_lifts_shadows_and_keeps_the_mean():
    seen = world(stones())
    sharp, hazy = counts(CLEAN, seen), counts(replace(CLEAN, stray_light=0.1), seen)
    assert hazy.mean() == pytest.approx(sharp.mean(), rel=1e-3)
    assert hazy[sharp == 0.0] == pytest.approx(0.1 * sharp.mean(), rel=0.01)


def test_hot_pixels_stay_and_grow_with_time():
    dark = world(elevation=-0.3)
    hot = replace(CLEAN, hot_pixels=0.01, hot_current=2e5, exposure=0.01)
    first, second = counts(hot, dark, seed=1), counts(hot, dark, seed=2)
    assert np.array_equal(first, second)
    lit = first > 0
    assert lit.mean() == pytest.approx(0.01, abs=0.003)
    mean = 2e5 * 0.01 / hot.full_well * 65535
    assert first[lit].mean() == pytest.approx(mean, rel=0.3)
    assert counts(replace(hot, exposure=0.02), dark)[lit].mean() == pytest.approx(
        2.0 * first[lit].mean(), rel=0.01
    )
    other = counts(replace(hot, detector_seed=7), dark)
    assert not np.array_equal(other > 0, lit)


@pytest.mark.parametrize("gain", [0.5, 2.0, 8.0])
def test_gain_and_full_well_clip_where_they_should(gain):
    camera = replace(CLEAN, gain=gain)
    electrons = 0.12 * np.sin(0.6) * CLEAN.sensitivity * CLEAN.exposure
    told = min(gain * min(electrons, CLEAN.full_well) / CLEAN.full_well, 1.0) * 65535
    assert counts(camera) == pytest.approx(told, abs=8.0)
    full = counts(replace(camera, exposure=1.0))
    assert np.all(full == np.rint(min(gain, 1.0) * 65535))


def test_rolling_shutter_shows_each_line_from_where_it_was():
    """Against a picture a line, each taken from the pose at that line's time, in free motion."""
    seen = world(stones())
    camera = replace(CLEAN, shutter="rolling", line_time=4e-4)
    moving = state(rate=(0.05, -0.3, 0.2), velocity=(20.0, -8.0, -60.0))
    rolled = counts(camera, seen, moving)
    told = np.empty_like(rolled)
    for line in range(0, 120, 7):
        late = 4e-4 * (line - 59.5)
        turn = quat_from_rotation_vector(late * moving.rate)
        then = replace(
            moving, position=moving.position + late * moving.velocity,
            attitude=quat_multiply(moving.attitude, turn),
        )  # fmt: skip
        told[line] = counts(CLEAN, seen, then)[line]
    lines = np.arange(0, 120, 7)
    still = counts(CLEAN, seen, moving)
    off = np.abs(rolled - told)[lines].mean()
    assert off < 0.25 * np.abs(still - told)[lines].mean()
    assert np.array_equal(counts(camera, seen), counts(CLEAN, seen))  # at rest: no difference


def test_antialiasing_is_the_mean_of_finer_pixels():
    seen = world(stones())
    fine = replace(CLEAN, width=480, height=360, fx=420.0, fy=420.0, cx=None, cy=None)
    told = counts(fine, seen).reshape(120, 3, 160, 3).mean((1, 3))
    ours = counts(replace(CLEAN, antialias=3), seen)
    assert np.abs(ours - told).max() <= 1.0
    assert np.abs(counts(CLEAN, seen) - told).max() > 1000.0


def test_exposure_settles_from_far_too_long_and_far_too_short():
    for first in (2e-5, 0.05):
        camera = AutoExposureCamera(replace(CLEAN, bits=8, exposure=first), ExposureControl())
        rng = np.random.default_rng(0)
        for k in range(6):
            picture = camera.measure(world(), state(), 0.1 * k, rng)
        assert picture.counts.max() == pytest.approx(0.8 * 255, abs=4)
        needed = 0.8 * CLEAN.full_well / (0.12 * np.sin(0.6) * CLEAN.sensitivity)
        assert camera.camera.exposure == pytest.approx(needed, rel=0.02)


def test_exposure_keeps_its_bounds_in_the_night_and_in_glare():
    control = ExposureControl(shortest=1e-4, longest=1e-2)
    black, white = np.zeros((4, 5), np.uint8), np.full((4, 5), 255, np.uint8)
    time = 1e-3
    for _ in range(5):
        time = control.next_exposure(black, 8, time)
    assert time == 1e-2
    assert control.next_exposure(white, 8, time) == pytest.approx(time / 8.0)
    for _ in range(5):
        time = control.next_exposure(white, 8, time)
    assert time == 1e-4


def test_a_commanded_exposure_stays():
    camera = AutoExposureCamera(replace(CLEAN, bits=8), ExposureControl())
    camera.command(1e-3, gain=2.0)
    rng = np.random.default_rng(0)
    for k in range(3):
        picture = camera.measure(world(), state(), 0.1 * k, rng)
    told = 0.12 * np.sin(0.6) * CLEAN.sensitivity * 1e-3 * 2.0 / CLEAN.full_well * 255
    assert np.all(np.abs(picture.counts - told) <= 1.0)
    with pytest.raises(InputError, match="exposure"):
        camera.command(0.0)
    assert camera.camera.exposure == 1e-3


def test_part_builds_what_it_says():
    rng = np.random.default_rng(0)
    assert isinstance(FramingCamera().build(rng, 0.1), Camera)
    assert rng.random() == np.random.default_rng(0).random()  # nothing was drawn
    auto = FramingCamera(exposure_control="auto", hot_pixels=0.01, exposure_level=0.5)
    built = auto.build(np.random.default_rng(1), 0.1)
    assert isinstance(built, AutoExposureCamera)
    assert built.control.bright_end_target == 0.5
    other = auto.build(np.random.default_rng(2), 0.1)
    assert built.camera.detector_seed != other.camera.detector_seed


@pytest.mark.parametrize(
    ("field", "value"),
    [("gain", 0.0), ("vignetting", -1.0), ("stray_light", 1.5), ("hot_pixels", np.nan),
     ("shutter", "slow"), ("antialias", 0), ("antialias", 5), ("line_time", -1.0),
     ("exposure", 0.0), ("hot_current", np.inf)],
)  # fmt: skip
def test_faults_that_cannot_be_are_refused(field, value):
    with pytest.raises(InputError, match=f"camera.{field}"):
        replace(CLEAN, **{field: value})


def test_a_pose_that_is_none_is_refused():
    rng = np.random.default_rng(0)
    lost = state()
    lost.position[0] = np.nan
    with pytest.raises(InputError, match=r"camera\.position"):
        CLEAN.expose(world(), lost, 0.0, rng)
    long = replace(state(), attitude=np.array([0.0, 0.0, 0.0, 1.5]))
    with pytest.raises(InputError, match=r"camera\.attitude"):
        CLEAN.expose(world(), long, 0.0, rng)
    with pytest.raises(InputError, match=r"camera\.attitude"):
        CLEAN.expose(world(), replace(state(), attitude=np.full(4, np.nan)), 0.0, rng)
