from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix, sensor_axes
from lunarsim.sensors import FlashLidar, ScanningLidar, gimbal_mount
from lunarsim.vehicle import State
from lunarsim.world import World
from tests.conftest import random_terrain, sloped_terrain

DOWN = sensor_axes([0.0, 0.0, -1.0])
STILL = np.array([0.0, 0.0, 0.0, 1.0])


def moving(times):
    """20 m/s east, 5 m/s down, turning at 0.1 rad/s about body y."""
    position = np.array([-10.0, 0.0, 60.0]) + times[:, None] * np.array([20.0, 0.0, -5.0])
    turn = np.column_stack((0.0 * times, 0.1 * times, 0.0 * times))
    return position, quat_from_rotation_vector(turn)


def test_a_raster_taken_in_motion_lies_on_the_ground_by_each_rays_own_pose():
    world = World(random_terrain(np.random.default_rng(2), relief=0.3), 1.622)
    lidar = ScanningLidar(40, 60, half_width=0.15, noise_ratio=0.0, ray_rate=5000.0)
    scan = lidar.scan(world, moving, 3.0 - 3.0, np.random.default_rng(0), DOWN)
    assert scan.delay is not None
    assert scan.delay[-1] == pytest.approx(2399 / 5000.0)
    right = scan.points(*moving(scan.time + scan.delay))
    seen = np.isfinite(scan.range)
    gap = np.abs(world.terrain.elevation(right[seen, :2]) - right[seen, 2])
    assert np.percentile(gap, 90) < 1e-6  # the rest are upright sides of rocks
    # One pose for all smears the points by the motion.
    wrong = scan.points(*(v[0] for v in moving(np.zeros(1))))
    assert np.nanmax(np.abs(wrong - right)) > 5.0


def test_a_raster_at_rest_is_a_flash():
    world = World(random_terrain(np.random.default_rng(3)), 1.622)
    here = np.array([0.0, 0.0, 40.0])
    state = State(here, np.zeros(3), STILL, np.zeros(3), 1.0)

    def rest(times):
        return np.tile(here, (times.size, 1)), np.tile(STILL, (times.size, 1))

    flash = FlashLidar(32, 32, 0.2).measure(world, state, 0.0, np.random.default_rng(1), DOWN)
    scan = ScanningLidar(32, 32, 0.2).scan(world, rest, 0.0, np.random.default_rng(1), DOWN)
    assert np.array_equal(flash.range, scan.range, equal_nan=True)


def test_a_wide_beam_measures_the_mean_of_its_footprint():
    """Over a slope the mean range of a symmetric beam is the centre's, to second order; over a
    step it is between the two levels."""
    slope = World(sloped_terrain((0.3, 0.0), 300.0), 1.622)
    state = State(np.array([0.0, 0.0, 200.0]), np.zeros(3), STILL, np.zeros(3), 1.0)
    thin, wide = (
        FlashLidar(8, 8, 0.05, noise_ratio=0.0, divergence=d).measure(
            slope, state, 0.0, np.random.default_rng(0), DOWN
        )
        for d in (0.0, 5e-3)
    )
    assert np.allclose(thin.range, wide.range, atol=0.01)
    rocky = World(random_terrain(np.random.default_rng(3), rocks=200), 1.622)
    low = State(np.array([0.0, 0.0, 60.0]), np.zeros(3), STILL, np.zeros(3), 1.0)
    sharp, soft = (
        FlashLidar(64, 64, 0.2, noise_ratio=0.0, divergence=d).measure(
            rocky, low, 0.0, np.random.default_rng(0), DOWN
        )
        for d in (0.0, 10e-3)
    )
    jumps = [np.nanmean(np.abs(np.diff(s.range.reshape(64, 64)))) for s in (sharp, soft)]
    assert jumps[1] < 0.8 * jumps[0]


def test_gimbal_points_within_its_limits():
    rng = np.random.default_rng(0)
    for _ in range(50):
        attitude = quat_from_rotation_vector(rng.normal(size=3))
        boresight = rng.normal(size=3)
        free = gimbal_mount(attitude, boresight)
        seen = quat_to_matrix(attitude) @ free[:, 2]
        assert np.allclose(seen, boresight / np.linalg.norm(boresight))
        held = gimbal_mount(attitude, boresight, 0.5)
        assert np.allclose(held @ held.T, np.eye(3), atol=1e-12)
        angle = np.arccos(np.clip(-held[2, 2], -1.0, 1.0))
        wanted = np.arccos(np.clip(-free[2, 2], -1.0, 1.0))
        assert angle == pytest.approx(min(wanted, 0.5), abs=1e-7)


def test_bad_scanners_are_refused():
    with pytest.raises(InputError, match=r"lidar\.ray_rate"):
        ScanningLidar(ray_rate=0.0)
    with pytest.raises(InputError, match=r"lidar\.divergence"):
        FlashLidar(divergence=-1.0)
