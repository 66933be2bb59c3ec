from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix, sensor_axes
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.vehicle import State
from lunarsim.world import World
from tests.worlds import flat_terrain, sloped_terrain

DOWN = sensor_axes([0.0, 0.0, -1.0])


def state(height: float, attitude=(0.0, 0.0, 0.0, 1.0)) -> State:
    return State(np.array([0.0, 0.0, height]), np.zeros(3), np.array(attitude), np.zeros(3), 1.0)


def test_coverage_and_spacing_are_those_of_the_paper():
    """Table 4: 100 x 100 m and 0.391 m between samples from 500 m."""
    world = World(flat_terrain(size=140.0, posting=2.0), 1.622)
    scan = FlashLidar(noise_ratio=0.0).measure(
        world, state(500.0), 0.0, np.random.default_rng(0), DOWN
    )
    points = scan.points(np.array([0.0, 0.0, 500.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    x = points[:256, 0]
    assert np.diff(x) == pytest.approx(np.full(255, 100.0 / 256), abs=1e-9)
    assert np.ptp(points[:, 1]) == pytest.approx(100.0 - 100.0 / 256, abs=1e-9)
    assert np.abs(points[:, 2]).max() < 1e-9


def test_noise_lies_along_the_ray_and_grows_with_range():
    world = World(flat_terrain(size=140.0, posting=2.0), 1.622)
    lidar = FlashLidar()
    clean = FlashLidar(noise_ratio=0.0)
    for height, sigma in ((500.0, 0.05 / 3), (250.0, 0.025 / 3)):
        noisy = lidar.measure(world, state(height), 0.0, np.random.default_rng(1), DOWN)
        exact = clean.measure(world, state(height), 0.0, np.random.default_rng(1), DOWN)
        error = noisy.range - exact.range
        assert np.std(error) == pytest.approx(sigma, rel=0.02)
        assert np.mean(error) == pytest.approx(0.0, abs=4 * sigma / 256)
        assert np.array_equal(noisy.direction, exact.direction)


def test_returns_off_the_map_are_nan():
    world = World(flat_terrain(size=40.0), 1.622)
    scan = FlashLidar().measure(world, state(500.0), 0.0, np.random.default_rng(0), DOWN)
    assert 0.1 < np.isfinite(scan.range).mean() < 0.2


def test_attitude_error_moves_the_points():
    """The truth decides where the sensor looks, the estimate where the points go."""
    world = World(flat_terrain(size=80.0), 1.622)
    tilt = quat_from_rotation_vector([0.0, 0.01, 0.0])
    mount = quat_to_matrix([0.0, 0.0, 0.0, 1.0]).T @ DOWN
    scan = FlashLidar(16, 16, noise_ratio=0.0).measure(
        world, state(200.0, tilt), 0.0, np.random.default_rng(0), mount
    )
    right = scan.points(np.array([0.0, 0.0, 200.0]), tilt)
    wrong = scan.points(np.array([0.0, 0.0, 200.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    assert np.abs(right[:, 2]).max() < 1e-9
    shift = np.mean(wrong[:, 0] - right[:, 0])
    assert shift == pytest.approx(200.0 * np.tan(0.01), rel=0.05)


@pytest.mark.parametrize(
    "change",
    [
        {"rows": 1},
        {"half_fov_tangent": 0.0},
        {"noise_ratio": -1.0},
        {"max_range": 0.0},
        {"pixel_spacing": "x"},
        {"max_incidence": 2.0},
        {"photons": 0.0},
    ],
)
def test_impossible_sensors(change):
    with pytest.raises(InputError, match="lidar"):
        FlashLidar(**change)


def test_pixels_even_in_the_angle():
    lidar = FlashLidar(5, 9, half_fov_tangent=0.5, pixel_spacing="angle")
    rays = lidar.directions().reshape(5, 9, 3)
    across = np.arctan2(rays[2, :, 0], rays[2, :, 2])
    assert np.allclose(np.diff(across), np.diff(across)[0])
    assert np.arctan(0.5) - across.max() == pytest.approx(0.5 * np.diff(across)[0])


def test_no_return_beyond_the_greatest_incidence():
    slope = World(sloped_terrain((0.3, 0.0), 200.0), 1.622)
    lidar = FlashLidar(32, 32, half_fov_tangent=0.2)
    normal = np.array([-0.3, 0.0, 1.0]) / np.hypot(0.3, 1.0)
    expected = np.arccos(-(lidar.directions() @ DOWN.T) @ normal)
    blind = FlashLidar(32, 32, half_fov_tangent=0.2, max_incidence=np.arctan(0.3))
    kept = blind.measure(slope, state(100.0), 0.0, np.random.default_rng(0), DOWN)
    assert np.array_equal(np.isfinite(kept.range), expected <= np.arctan(0.3))


@pytest.mark.parametrize("height", [500.0, 1000.0])
def test_returns_are_lost_as_photons_get_few(height):
    world = World(flat_terrain(800.0, 8.0), 1.622)
    lidar = FlashLidar(photons=2.0)
    scan = lidar.measure(world, state(height), 0.0, np.random.default_rng(1), DOWN)
    cosine = -(scan.direction @ DOWN.T)[:, 2]
    mean = 2.0 * cosine * (500.0 * cosine / height) ** 2
    expected = np.mean(np.exp(-mean))
    spread = np.sqrt(expected * (1.0 - expected) / cosine.size)
    assert np.mean(np.isnan(scan.range)) == pytest.approx(expected, abs=4.0 * spread)
    assert np.array_equal(np.isnan(scan.range), np.isnan(scan.sigma))


def test_what_is_stated_contains_no_truth():
    world = World(flat_terrain(800.0, 8.0), 1.622)
    lidar = FlashLidar(16, 16)
    scan = lidar.measure(world, state(500.0), 0.0, np.random.default_rng(1), DOWN)
    true = 500.0 / -(scan.direction @ DOWN.T)[:, 2]
    assert np.abs(scan.range - true).max() > 0.02
    assert scan.sigma == pytest.approx(lidar.noise_ratio * scan.range)


def test_noise_floor_adds_to_the_proportional_noise_in_quadrature():
    """The spread of the ranges is the stated sigma, near and far."""
    world = World(flat_terrain(size=140.0, posting=2.0), 1.622)
    exact = FlashLidar(noise_ratio=0.0)
    noisy = FlashLidar(noise_ratio=1e-4, noise_floor=0.02)
    for height, sigma in ((20.0, np.hypot(0.02, 2e-3)), (500.0, np.hypot(0.02, 0.05))):
        true = exact.measure(world, state(height), 0.0, np.random.default_rng(1), DOWN)
        scan = noisy.measure(world, state(height), 0.0, np.random.default_rng(1), DOWN)
        assert np.std(scan.range - true.range) == pytest.approx(sigma, rel=0.02)
        assert scan.sigma == pytest.approx(np.full(scan.range.size, sigma), rel=0.02)


@pytest.mark.parametrize("bias", [0.0, 0.013])
def test_ranges_are_multiples_of_the_range_step(bias):
    """The stated sigma contains the rounding error of a uniform distribution."""
    world = World(flat_terrain(size=60.0, posting=2.0), 1.622)
    step = 0.05
    exact = FlashLidar(64, 64, noise_ratio=0.0)
    lidar = FlashLidar(64, 64, noise_ratio=0.0, range_step=step, range_bias=bias)
    sensor = lidar.build(np.random.default_rng(0), 0.01)
    true = exact.measure(world, state(200.0), 0.0, np.random.default_rng(1), DOWN)
    scan = sensor.measure(world, state(200.0), 0.0, np.random.default_rng(1), DOWN)
    assert np.abs(scan.range / step - np.rint(scan.range / step)).max() < 1e-6
    error = scan.range - true.range - bias
    assert np.abs(error).max() <= 0.5 * step + 1e-9
    assert scan.sigma == pytest.approx(np.full(64 * 64, step / np.sqrt(12.0)))
    both = FlashLidar(noise_ratio=1e-4, noise_floor=0.01, range_step=step)
    assert both.stated_sigma(100.0) == pytest.approx(np.sqrt(1e-4 + 1e-4 + step**2 / 12.0))


def test_false_returns_are_uniform_between_sensor_and_terrain():
    world = World(flat_terrain(size=60.0, posting=2.0), 1.622)
    clean = FlashLidar(noise_ratio=0.0)
    lidar = FlashLidar(noise_ratio=0.0, false_return_fraction=0.1)
    true = clean.measure(world, state(200.0), 0.0, np.random.default_rng(1), DOWN).range
    scan = lidar.measure(world, state(200.0), 0.0, np.random.default_rng(1), DOWN)
    false = scan.range != true
    n = false.size
    assert false.mean() == pytest.approx(0.1, abs=4.0 * np.sqrt(0.09 / n))
    assert scan.range.min() > 0.0
    share = scan.range[false] / true[false]
    assert share.max() <= 1.0
    count = np.histogram(share, bins=10, range=(0.0, 1.0))[0]
    assert count == pytest.approx(np.full(10, 0.01 * n), abs=4.5 * np.sqrt(0.01 * n))


def test_a_range_that_is_not_positive_is_no_return():
    world = World(flat_terrain(size=20.0), 1.622)
    lidar = FlashLidar(8, 8, noise_ratio=0.0, range_step=9.0)
    scan = lidar.measure(world, state(3.0), 0.0, np.random.default_rng(0), DOWN)
    assert np.isnan(scan.range).all()
