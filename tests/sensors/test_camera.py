"""The camera's optics and detector."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.rocks.field import RockField
from lunarsim.sensors.camera import Camera
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


def state(height=50.0, rate=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0, 1.0)):
    return State(
        np.array([0.0, 0.0, height]), np.zeros(3), np.array(attitude), np.array(rate), 1000.0
    )


def world(terrain=GROUND, **light):
    return World(terrain, 1.622, Light(**({"azimuth": 1.0, "elevation": 0.6} | light)))


def test_counts_follow_radiance_exposure_and_converter():
    sun = {"photometry": "lambert", "albedo": 0.2}
    photo = CLEAN.expose(world(**sun), state(), 1.5, np.random.default_rng(0))
    electrons = 0.2 * np.sin(0.6) * CLEAN.sensitivity * CLEAN.exposure
    assert photo.time == 1.5
    assert photo.counts.dtype == np.uint16
    assert np.allclose(photo.counts, electrons / CLEAN.full_well * 65535, atol=8.0)
    long = replace(CLEAN, exposure=1.0).expose(world(**sun), state(), 0.0, np.random.default_rng(0))
    assert np.all(long.counts == 65535)


def test_photon_transfer():
    """Variance is the mean (shot noise) plus the square of the read noise, in electrons."""
    camera = replace(CLEAN, shot_noise=True, read_noise=20.0)
    photo = camera.expose(world(photometry="lambert"), state(), 0.0, np.random.default_rng(3))
    electrons = photo.counts.astype(float) * camera.full_well / 65535
    mean = 0.12 * np.sin(0.6) * camera.sensitivity * camera.exposure
    pixels = electrons.size
    assert electrons.mean() == pytest.approx(mean, abs=5.0 * np.sqrt((mean + 400.0) / pixels))
    assert electrons.var() == pytest.approx(mean + 400.0, rel=5.0 * np.sqrt(2.0 / pixels))


def test_same_generator_same_bits():
    camera = replace(CLEAN, shot_noise=True, read_noise=20.0)
    first, second = (
        camera.expose(world(), state(), 0.0, np.random.default_rng(7)).counts for _ in range(2)
    )
    assert np.array_equal(first, second)


def test_distortion_is_opencvs():
    """Where each rock appears, against `cv2.projectPoints`."""
    x, y = np.meshgrid(np.linspace(-20.0, 20.0, 5), np.linspace(-14.0, 14.0, 4))
    rocks = RockField.hemispheres(x.ravel(), y.ravel(), 0.0, 1.2)
    camera = replace(CLEAN, width=320, height=240, fx=280.0, fy=280.0, cx=None, cy=None,
                     distortion=(-0.25, 0.08, 0.002, -0.001, 0.0))  # fmt: skip
    terrain = Terrain(GROUND.relief, rocks)
    photo = camera.expose(world(terrain), state(), 0.0, np.random.default_rng(0), truth=True)
    axes = camera.view(state()).axes
    assert photo.truth is not None
    for n in range(len(rocks)):
        # A hemisphere's silhouette is not centred on its middle; compare outlines instead.
        v, u = np.nonzero(photo.truth.identity == n)
        angle = np.linspace(0.0, 2.0 * np.pi, 100)
        ring = np.column_stack(
            (rocks.x[n] + 1.2 * np.cos(angle), rocks.y[n] + 1.2 * np.sin(angle), 0.0 * angle)
        )
        seen = (ring - [0.0, 0.0, 50.0]) @ axes
        zero = np.zeros(3)
        expected, _ = cv2.projectPoints(
            seen, zero, zero, camera.pinhole.matrix, np.array(camera.distortion)
        )
        low, high = expected.reshape(-1, 2).min(0), expected.reshape(-1, 2).max(0)
        inner = axes[:, :2].T @ -np.array([rocks.x[n], rocks.y[n], 0.0])
        # The side away from the middle of the picture rises over the ring; the other is the ring.
        for k, pixels in enumerate((u, v)):
            if inner[k] > 5.0:
                assert abs(pixels.max() - high[k]) < 1.25
            elif inner[k] < -5.0:
                assert abs(pixels.min() - low[k]) < 1.25


def test_motion_blur_smears_by_rate_times_exposure():
    rock = Terrain(GROUND.relief, RockField.hemispheres(0.0, 0.0, 0.0, 0.6))
    camera = replace(CLEAN, motion_blur=True, exposure=0.1, sensitivity=1e6)
    still = camera.expose(world(rock), state(), 0.0, np.random.default_rng(0)).counts.astype(float)
    turn = 0.5  # rad/s about body y: the ground runs along image columns' direction
    moved = camera.expose(
        world(rock), state(rate=(0.0, turn, 0.0)), 0.0, np.random.default_rng(0)
    ).counts.astype(float)  # fmt: skip
    length = turn * camera.exposure * camera.fx  # 7 pixels
    # The mean of the pictures taken by a camera turned by parts of the angle.
    total = np.zeros_like(still)
    parts = np.linspace(-0.5, 0.5, 41)
    for part in parts:
        q = quat_from_rotation_vector([0.0, turn * camera.exposure * part, 0.0])
        turned = quat_multiply([0.0, 0.0, 0.0, 1.0], q)
        total += camera.expose(
            world(rock), state(attitude=turned), 0.0, np.random.default_rng(0)
        ).counts
    assert length > 5.0
    smear = np.abs(total / parts.size - moved).mean()
    assert smear < 0.3 * np.abs(moved - still).mean()


def test_point_spread_keeps_light_and_spreads_it():
    rock = Terrain(GROUND.relief, RockField.hemispheres(0.0, 0.0, 0.0, 0.6))
    rng = np.random.default_rng(0)
    sharp = CLEAN.expose(world(rock), state(), 0.0, rng).counts.astype(float)
    soft = replace(CLEAN, blur_sigma=1.5).expose(world(rock), state(), 0.0, rng).counts
    assert soft.mean() == pytest.approx(sharp.mean(), rel=1e-4)
    assert soft.std() < 0.9 * sharp.std()


def test_mounted_with_offset_and_rotation():
    turned = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    camera = replace(CLEAN, offset=(1.0, 2.0, -0.5), mount=turned)
    view = camera.view(state())
    assert np.allclose(view.position, [1.0, 2.0, 49.5])
    assert np.allclose(view.axes[:, 2], [1.0, 0.0, 0.0])  # looks forward


@pytest.mark.parametrize(
    ("field", "value"),
    [("fx", 0.0), ("exposure", -1.0), ("bits", 17), ("blur_sigma", np.nan), ("width", 0),
     ("mount", np.eye(2)), ("full_well", np.inf)],
)  # fmt: skip
def test_bad_values_are_refused(field, value):
    with pytest.raises(InputError, match="camera"):
        replace(CLEAN, **{field: value})
