"""Test the registration of scans: Jacobians and covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.evaluation.consistency import Consistency, normalised_squared_error
from lunarsim.frames import (
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
)
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.messages.prior_map import PriorMap
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.navigation.corrected_scan import CorrectedScan, average_scan
from lunarsim.onboard.navigation.map_features import MapFeatures
from lunarsim.onboard.navigation.registration import (
    fit_residuals,
    register_scan,
)
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.survey import simulate_survey
from lunarsim.world.terrain import Terrain, hazard_field
from tests.chance import ratio_bounds
from tests.lidar_descent import Surveyed

POSITION = np.array([-200.0, 10.0, 150.0])
ATTITUDE = quat_from_rotation_vector([0.02, -0.05, 0.3])
LIDAR = FlashLidar(192, 192, 0.04, 1e-5)


@pytest.fixture(scope="module")
def world():
    return World(hazard_field(np.random.default_rng(4), boulders=200, craters=30), 9.81)


def scanned(world, rng, aim=(0.0, 0.0, 0.0), position=POSITION):
    state = State(position, np.zeros(3), ATTITUDE, np.zeros(3), 1.0)
    mount = gimbal_mount(ATTITUDE, np.asarray(aim) - position)
    return LIDAR.measure(world, state, 0.0, rng, mount)


def test_surface_of_a_plane_is_the_plane():
    rng = np.random.default_rng(1)
    xy = rng.uniform(-5.0, 5.0, (20_000, 2))
    points = np.column_stack((xy, 0.2 * xy[:, 0] - 0.1 * xy[:, 1] + 3.0))
    surface = average_scan(points, Grid(0.0, 0.0, 0.5, 1, 1))
    x, y, z = surface.position.T
    assert len(surface) > 200
    # The means of the neighbours lie slightly beside the axes.
    assert z == pytest.approx(0.2 * x - 0.1 * y + 3.0, abs=2e-3)
    assert surface.normal == pytest.approx(np.tile([-0.2, 0.1, 1.0], (len(x), 1)), abs=0.02)


def test_jacobians_match_finite_differences():
    rng = np.random.default_rng(3)
    velocity, rate = rng.normal(size=3), 0.1 * rng.normal(size=3)
    direction = np.array([[0.02, -0.03, 1.0]]) / np.linalg.norm([0.02, -0.03, 1.0])
    mount = quat_to_matrix(quat_from_rotation_vector([2.2, 0.3, -0.1]))
    flash = LidarScan(0.0, np.array([240.0]), direction, mount, np.ones(1), (1, 1))
    seen = CorrectedScan(flash, POSITION, ATTITUDE, velocity, rate)
    p, n = seen.points()[0], np.array([0.1, -0.2, 1.0])
    moved = []
    for i in range(11):
        error = np.zeros(11)
        error[i] = 1e-6
        moved.append((seen.corrected_by(error).points()[0] - p) / 1e-6)
    moved = np.array(moved).T
    assert seen.point_jacobian(p) == pytest.approx(moved, abs=1e-3)
    assert seen.jacobian(p[None], n[None])[0] == pytest.approx(n @ moved, abs=1e-3)
    # By hand: a rotation, and 1 m of range along the ray.
    body = quat_rotate(quat_conjugate(ATTITUDE), p - POSITION)
    assert np.linalg.norm(moved[:, 6]) == pytest.approx(1.0)
    assert moved[:, 3] == pytest.approx(
        quat_rotate(ATTITUDE, np.cross([1.0, 0.0, 0.0], body)), abs=1e-3
    )


def fitted(scan, prior, before, error, variance):
    """Fit a scan from a pose with an error (6,): return estimate, covariance, outcome."""
    # Truth = estimate + error; the scanner has no error.
    attitude = quat_multiply(ATTITUDE, quat_from_rotation_vector(-error[3:]))
    seen = CorrectedScan(scan, POSITION - error[:3], attitude, np.zeros(3), np.zeros(3))
    whole = np.zeros((11, 11))
    whole[:6, :6] = before
    result, _ = register_scan(seen, MapFeatures(prior), whole, np.full(prior.grid.shape, variance))
    result = replace(result, information=result.information[:6, :6], vector=result.vector[:6])
    covariance = np.linalg.inv(result.information + np.linalg.inv(before))
    return covariance @ result.vector, covariance, result


def registered(world, seed, stale=0.0):
    """Return the error's estimate, its covariance and the error of one registration."""
    rng = np.random.default_rng(seed)
    prior = simulate_survey(
        Surveyed.of(world), Grid.centred((0.0, 0.0), 120.0, 0.5), rng, sigma=0.1,
        outdated_fraction=stale,
    )  # fmt: skip
    before = np.diag(np.square([0.3, 0.3, 0.3, 1e-3, 1e-3, 1e-3]))
    error = np.sqrt(np.diag(before)) * rng.standard_normal(6)
    scan = scanned(world, rng, rng.uniform(-30.0, 30.0, 2).tolist() + [0.0])
    found, covariance, result = fitted(scan, prior, before, error, prior.sigma**2 + 0.03**2)
    return found, covariance, error, result


@pytest.mark.statistical
def test_registration_has_the_error_of_its_covariance(world):
    runs = 50
    nees = Consistency()
    for seed in range(runs):
        found, covariance, error, result = registered(world, seed)
        nees = nees.plus(normalised_squared_error(found - error, covariance), 6)
        assert result.agreeing_fraction > 0.9
    low, high = ratio_bounds(nees.degrees)
    assert low < nees.ratio < high


def test_patches_out_of_date_are_left_out(world):
    gaps = {False: [], True: []}
    shares = {False: [], True: []}
    for seed in range(12):
        found, _, error, result = registered(world, seed, stale=0.2)
        gaps[True].append(np.linalg.norm((found - error)[:3]))
        shares[True].append(result.agreeing_fraction)
        found, _, error, result = registered(world, seed)
        shares[False].append(result.agreeing_fraction)
        gaps[False].append(np.linalg.norm((found - error)[:3]))
    assert np.median(shares[True]) < np.median(shares[False]) - 0.02
    assert np.median(gaps[True]) < 2.0 * np.median(gaps[False]) + 0.05


@pytest.mark.parametrize("stale", [0.0, 0.2])
def test_a_fit_started_far_off_is_right_or_reports_only_the_level(world, stale):
    accepted = sharp = 0
    for seed in range(40):
        rng = np.random.default_rng([seed, 7])
        grid = Grid.centred((0.0, 0.0), 120.0, 0.5)
        prior = simulate_survey(Surveyed.of(world), grid, rng, sigma=0.1, outdated_fraction=stale)
        before = np.diag(np.square([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3]))
        error = np.sqrt(np.diag(before)) * rng.standard_normal(6)
        scan = scanned(world, rng, [*rng.uniform(-40.0, 40.0, 2), 0.0])
        found, covariance, result = fitted(
            scan, prior, before, error, 2.0 * prior.sigma**2 + 0.03**2
        )
        if result.agreeing_fraction < 0.7 or result.misfit > 1.6:
            continue
        accepted += 1
        gap = found - error
        # Chi-squared of 6 exceeds 40 once in two million.
        assert normalised_squared_error(gap, covariance) < 40.0, seed
        sharp += covariance[0, 0] < 0.25
    assert accepted >= 30
    # The fit is informative where the terrain is.
    assert sharp >= 5


@pytest.mark.statistical
def test_errors_that_are_alike_do_not_make_a_fit_too_sure(world):
    nees = Consistency()
    for seed in range(90):
        rng = np.random.default_rng([seed, 8])
        grid = Grid.centred((0.0, 0.0), 120.0, 0.5)
        prior = simulate_survey(Surveyed.of(world), grid, rng, sigma=0.1, correlation=1.5)
        # The map does not specify the correlation of its errors.
        prior = PriorMap(grid, prior.elevation, 0.1)
        before = np.diag(np.square([0.1, 0.1, 0.3, 1e-3, 1e-3, 1e-3]))
        error = np.sqrt(np.diag(before)) * rng.standard_normal(6)
        scan = scanned(world, rng, [*rng.uniform(-30.0, 30.0, 2), 0.0])
        found, covariance, result = fitted(scan, prior, before, error, prior.sigma**2 + 0.03**2)
        nees = nees.plus(normalised_squared_error(found - error, covariance), 6)
    # The fits share a world, so the bound comes from 16 other draws: 1.67 with a standard deviation
    # of 0.09. The ratio is above 1 because the map does not declare its correlated errors. If the
    # residuals count as independent, it is 19.
    assert nees.ratio < 2.1, nees.ratio


def test_errors_that_a_map_reports_as_correlated_count_as_fewer(world):
    rng = np.random.default_rng(8)
    grid = Grid.centred((0.0, 0.0), 120.0, 0.5)
    alone = simulate_survey(Surveyed.of(world), grid, rng, sigma=0.1)
    alike = PriorMap(grid, alone.elevation, 0.1, 1.0)
    before = np.diag(np.square([0.05, 0.05, 0.3, 1e-3, 1e-3, 1e-3]))
    scan = scanned(world, rng)
    fits = [fitted(scan, p, before, np.zeros(6), 0.1**2 + 0.03**2)[2] for p in (alone, alike)]
    assert alike.equivalent_correlated_posts > 20.0
    ratio = fits[0].information[2, 2] / fits[1].information[2, 2]
    assert 0.5 * alike.equivalent_correlated_posts < ratio < 1.1 * alike.equivalent_correlated_posts


def test_where_the_place_is_open_slopes_make_the_level_uncertain(world):
    """With a larger position uncertainty, slopes add more height variance."""
    rng = np.random.default_rng(9)
    grid = Grid.centred((0.0, 0.0), 120.0, 0.5)
    prior = simulate_survey(Surveyed.of(world), grid, rng, sigma=0.6)
    scan = scanned(world, rng)
    information = []
    for far in (1.5, 15.0):
        before = np.diag(np.square([far, far, 0.3, 1e-3, 1e-3, 1e-3]))
        information.append(fitted(scan, prior, before, np.zeros(6), 0.6**2)[2].information)
    for one in information:
        assert one[0, 0] < 0.05 * one[2, 2], "only the height"
    assert information[1][2, 2] < 0.9 * information[0][2, 2]


def test_fit_without_data_gives_no_information():
    result = fit_residuals(np.zeros((0, 6)), np.zeros(0), np.zeros(0), np.eye(6))
    assert result.used == result.compared == 0
    assert result.agreeing_fraction == 0.0
    assert not result.information.any()


def test_a_survey_is_the_mean_of_the_terrain_with_its_noise():
    terrain = hazard_field(np.random.default_rng(1), boulders=50, craters=5)
    grid = Grid.centred((0.0, 0.0), 60.0, 1.0)
    exact = simulate_survey(terrain, grid, np.random.default_rng(2), sigma=1e-9)
    x, y = grid.centre_of(20, 31)
    u = (np.arange(40) + 0.5) / 40 - 0.5
    fine = terrain.elevation(np.stack(np.meshgrid(x + u, y + u), -1))
    assert exact.elevation[20, 31] == pytest.approx(fine.mean(), abs=0.02)
    noisy = simulate_survey(terrain, grid, np.random.default_rng(2), sigma=0.2)
    assert np.std(noisy.elevation - exact.elevation) == pytest.approx(0.2, rel=0.05)
    stale = simulate_survey(
        terrain, grid, np.random.default_rng(2), sigma=1e-9, outdated_fraction=0.3
    )
    changed = np.abs(stale.elevation - exact.elevation) > 1e-6
    assert 0.1 < changed.mean() < 0.35


def test_impossible_maps_are_refused():
    grid = Grid.centred((0.0, 0.0), 10.0, 1.0)
    flat = np.zeros(grid.shape)
    for elevation in (np.zeros((3, 3)), np.full(grid.shape, np.nan), np.full(grid.shape, np.inf)):
        with pytest.raises(InputError, match=r"prior\.elevation"):
            PriorMap(grid, elevation, 0.1)
    with pytest.raises(InputError, match=r"prior\.sigma_m"):
        PriorMap(grid, flat, 0.0)
    terrain = Terrain(hazard_field(np.random.default_rng(0), boulders=0, craters=0).relief)
    with pytest.raises(InputError, match=r"prior_map\.outdated_fraction"):
        simulate_survey(terrain, grid, np.random.default_rng(0), outdated_fraction=1.0)
