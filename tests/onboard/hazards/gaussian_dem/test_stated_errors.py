"""Test the Gaussian DEM with more noise or tilt than its scans and poses state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim import Grid, Terrain
from lunarsim.api import Estimate, LidarScan, State
from lunarsim.frames import quat_from_rotation_vector
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper, SamplePool
from lunarsim.onboard.hazards.gaussian_dem.scan_noise import noise_ratio, with_estimated_noise
from lunarsim.rocks.field import RockField
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.world import World
from lunarsim.world.terrain import fractal_relief

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
GRID = Grid.centred((0.0, 0.0), 14.0, 0.2)
SIGMA = 0.01


def scan_of(image, sigma=SIGMA):
    direction = np.tile([0.0, 0.0, 1.0], (image.size, 1))
    mount = np.diag([1.0, -1.0, -1.0])
    return LidarScan(0.0, image.ravel(), direction, mount, np.full(image.size, sigma), image.shape)


def noisy_image(seed, ratio, shape=(80, 80)):
    """Return a slope of the given shape with `ratio` times the stated noise."""
    rng, (row, col) = np.random.default_rng(seed), np.mgrid[: shape[0], : shape[1]]
    return 200.0 + 0.3 * row - 0.2 * col + ratio * SIGMA * rng.standard_normal(shape)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 4.0, 8.0])
def test_the_noise_is_estimated_on_a_slope_with_lost_returns(ratio):
    image = noisy_image(1, ratio)
    image[np.random.default_rng(2).random(image.shape) < 0.1] = np.nan
    found = [noise_ratio(scan_of(image)), noise_ratio(scan_of(image, 2.0 * SIGMA))]
    assert found == pytest.approx([ratio, 0.5 * ratio], rel=0.2)


def test_terrain_as_rough_as_a_random_walk_is_not_taken_for_noise():
    rng = np.random.default_rng(3)
    walk = np.cumsum(8.0 * SIGMA * rng.standard_normal((80, 80)), axis=1)
    assert noise_ratio(scan_of(200.0 + walk)) < 2.0
    assert noise_ratio(scan_of(noisy_image(4, 8.0) + walk)) > 4.0


def test_rocks_between_the_pixels_are_not_taken_for_noise():
    """A fifth of the pixels hits a rock: the largest expected cover."""
    for seed in range(5, 15):
        image, rng = noisy_image(seed, 1.0, (128, 128)), np.random.default_rng(seed)
        rocks = rng.random(image.shape) < 0.2
        image[rocks] -= rng.uniform(0.1, 1.0, rocks.sum())
        scan = scan_of(image)
        assert 1.5 < noise_ratio(scan) < 2.3
        assert with_estimated_noise(scan_of(noisy_image(seed, 1.5))).sigma[0] == SIGMA


def test_only_clearly_larger_noise_changes_a_scan():
    nominal = scan_of(noisy_image(6, 1.0))
    assert with_estimated_noise(nominal) is nominal
    noisy = scan_of(noisy_image(7, 8.0))
    assert with_estimated_noise(noisy).sigma == pytest.approx(8.0 * SIGMA, rel=0.2)
    few = scan_of(noisy_image(8, 8.0, (30, 30)))
    assert np.isnan(noise_ratio(few))
    assert with_estimated_noise(few) is few


@pytest.fixture(scope="module")
def shots():
    """Return two scans of fractal relief and their positions; scan 3 has 8 times the noise."""
    relief = fractal_relief(
        Grid.centred((0.0, 0.0), 40.0, 0.25), np.random.default_rng(1), hurst=0.85,
        rms_slope=np.deg2rad(3.0),
    )  # fmt: skip
    world, out = World(Terrain(relief, RockField.empty()), 1.622), []
    for n, (height, ratio) in enumerate(((100.0, 1.0), (90.0, 1.0), (100.0, 8.0))):
        lidar = FlashLidar(rows=128, cols=128)
        lidar = replace(lidar, noise_ratio=ratio * lidar.noise_ratio)
        position = np.array([0.3 * n, 0.2 * n, height])
        state = State(position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
        out.append((lidar.measure(world, state, 0.0, np.random.default_rng(n)), position))
    return out


def pose(position, tilt_deg=0.0, sigma_deg=0.0):
    """Return an estimate with a tilt error about the east axis and its stated sigma."""
    attitude = quat_from_rotation_vector([np.deg2rad(tilt_deg), 0.0, 0.0])
    own = np.diag([0.0] * 6 + [np.deg2rad(sigma_deg) ** 2] * 3)
    return Estimate(0.0, position, np.zeros(3), attitude, np.zeros(3), 1.0, own)


def test_a_map_with_understated_noise_has_the_noise_of_its_scans(shots):
    scan, position = shots[2]
    stated, understated = GaussianDemMapper(GRID, Lander()), GaussianDemMapper(GRID, Lander())
    stated.update(scan, pose(position))
    understated.update(replace(scan, sigma=scan.sigma / 8.0), pose(position))
    noise = [one.evidence().site_evidence.noise for one in (stated, understated)]
    assert noise[1] == pytest.approx(noise[0], rel=0.1)
    p = [one.hazard_map().p_safe for one in (stated, understated)]
    assert np.abs(p[1] - p[0]).mean() < 0.02


@pytest.mark.parametrize(
    ("tilt_deg", "sigma_deg", "is_claimed"),
    [(0.0, 0.0, True), (0.04, 0.0, True), (0.25, 0.0, False), (-0.5, 0.0, False),
     (0.25, 0.2, True), (0.25, np.nan, True)],
)  # fmt: skip
def test_scans_tilted_by_more_than_stated_leave_the_domain(shots, tilt_deg, sigma_deg, is_claimed):
    mapper = GaussianDemMapper(GRID, Lander())
    for (scan, position), tilt in zip(shots[:2], (0.0, tilt_deg), strict=True):
        mapper.update(scan, pose(position, tilt, sigma_deg))
    found, evidence = mapper.hazard_map(), mapper.evidence().site_evidence
    assert found.observed.any()
    assert found.in_domain.any() == is_claimed
    assert (found.p_safe >= 0.95).any() == is_claimed
    wide = CalibrationDomain(10.0, 10.0, (0.0, 1.0), (0.0, 1.0))
    assert wide.contains(evidence).any() == is_claimed
    # A map without samples starts again.
    mapper.recentre(np.array([100.0, 0.0, 0.0]))
    mapper.recentre(np.zeros(3))
    mapper.update(shots[0][0], pose(shots[0][1]))
    assert mapper.hazard_map().in_domain.any()


def test_the_tilt_is_the_angle_between_scan_and_samples(shots):
    pool = SamplePool(GRID)
    scan, position = shots[0]
    pool.add(scan.points(position, UPRIGHT), scan.height_sigma(UPRIGHT), scan.spacing(UPRIGHT))
    scan, position = shots[1]
    for tilt in (0.0, 0.1, 0.2):
        offset = pool.offset(scan.points(position, pose(position, tilt).attitude))
        assert np.rad2deg(offset.tilt) == pytest.approx(tilt, rel=0.2, abs=0.02)
        assert offset.is_tilted(0.0) == (tilt > 0.0)
    points = scan.points(position, UPRIGHT)
    assert pool.offset(points[::64]).tilt_sigma == np.inf, "too few points"


def test_a_shift_that_alignment_leaves_is_not_taken_for_a_tilt():
    """In a bowl, a shift changes the heights like a tilt."""

    def bowl(seed, shift=0.0):
        rng = np.random.default_rng(seed)
        xy = rng.uniform(-7.0, 7.0, (8000, 2))
        z = 0.03 * ((xy[:, 0] - shift) ** 2 + xy[:, 1] ** 2)
        return np.column_stack((xy, z + rng.normal(0.0, 0.005, len(xy))))

    pool = SamplePool(GRID)
    pool.add(bowl(1), 0.005, 0.2)
    offset = pool.offset(bowl(2, shift=0.04))
    assert offset.shift[0] == 0.0
    assert not offset.is_tilted(0.0)
