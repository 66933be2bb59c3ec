"""Test the augmented filter against finite differences and filterpy."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from lunarsim.errors import InputError
from lunarsim.evaluation.consistency import Consistency, normalised_squared_error
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.measurements import AltimeterReading
from lunarsim.onboard.navigation import matrix_2x2
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior
from tests.chance import ratio_bounds, sample_sizes
from tests.reference.shadows import consider_update
from tests.rock_scene import GRAVITY, Flight


def fly(flight, seconds, images=True, ranges=True):
    """Return NIS of images and ranges over a flight."""
    nis = []
    for k in range(int(10 * seconds)):
        flight.advance()
        if images:
            nis.append((flight.image(), 2 * flight.seen))
        if ranges and k % 2 == 0:
            nis.append((flight.range(), 1))
    return [(value, size) for value, size in nis if value is not None]


def shifted(rocks, error):
    """Return a filter without rocks, with an error of the lander (15,)."""
    s = rocks.inertial
    inertial = StrapdownState(
        s.position + error[:3], s.velocity + error[3:6],
        quat_multiply(s.attitude, quat_from_rotation_vector(error[9:12])), GRAVITY,
    )  # fmt: skip
    return RockFilter.of(inertial)


def test_reset_rocks_equal_new_rocks():
    """Earlier observations are discarded, as if there had been none."""
    filters = []
    for early in (True, False):
        flight = Flight(np.random.default_rng(7))
        flight.advance()
        camera = flight.camera()
        seen = flight.look(camera)
        f = flight.filter
        if early:
            f.add(camera, flight.ground_of(seen[0], camera), seen[1], seen[2], seen[3])
        for _ in range(10):
            flight.advance()
        camera = flight.camera()
        pixel, covariance, radius, variance = flight.look(camera)
        if early:
            f.reset_positions(np.arange(len(radius)), camera, pixel, covariance, radius, variance)
        else:
            f.add(camera, flight.ground_of(pixel, camera), covariance, radius, variance)
        filters.append(f)
    anew, then = filters
    assert anew.xyz == pytest.approx(then.xyz, abs=1e-9)
    assert anew.radius == pytest.approx(then.radius)
    assert anew.radius_variance == pytest.approx(then.radius_variance)
    np.testing.assert_allclose(anew.covariance, then.covariance, rtol=1e-9, atol=1e-12)


def test_reset_rocks_keep_height_errors_only():
    """A reset equals a measurement with an uninformative prior."""
    flight = Flight(np.random.default_rng(9), ground=TerrainPrior(0.0, 2.0, 0.1))
    flight.draw_heights(2.0, 0.1)
    for _ in range(3):
        flight.advance()
        flight.image()
    flight.advance()
    f, camera = flight.filter, flight.camera()
    pixel, covariance, radius, variance = flight.look(camera)
    index, level = np.arange(f.count), f.state_indices()[:, :2].ravel()
    p, places, interpolate_heights = f.covariance.copy(), f.xyz.copy(), f.xyz[:, 2].copy()
    assert p[f.state_indices()[:, 2], f.state_indices()[:, 2]].min() > 0.01
    f.reset_positions(index, camera, pixel, covariance, radius, variance)
    anew, anew_xyz = f.covariance.copy(), f.xyz.copy()
    assert np.array_equal(anew_xyz[:, 2], interpolate_heights)
    f.covariance[:] = p
    f.covariance[level], f.covariance[:, level] = 0.0, 0.0
    f.covariance[level, level] = 1e7
    f.xyz[:] = np.column_stack((anew_xyz[:, :2], places[:, 2]))
    f.update_rocks(index, f.project_rocks(camera), pixel, covariance, radius, variance)
    assert f.xyz == pytest.approx(anew_xyz, abs=1e-6)
    scale = np.sqrt(np.outer(anew.diagonal(), anew.diagonal())) + 1e-12
    assert np.abs(f.covariance - anew).max() < 1e-3 * scale.max()
    assert (np.abs(f.covariance - anew) / scale).max() < 1e-3


def test_reset_without_terrain_is_rejected():
    flight = Flight(np.random.default_rng(7))
    flight.advance()
    flight.image()
    f, camera = flight.filter, flight.camera()
    before, places = f.covariance.copy(), f.xyz.copy()
    sky = np.array([[320.0, -1e6]])
    with pytest.raises(InputError, match="in front of the camera"):
        f.reset_positions(np.array([0]), camera, sky, np.eye(2)[None], np.ones(1), np.ones(1))
    assert np.array_equal(f.covariance, before) and np.array_equal(f.xyz, places)


def test_jacobians_equal_finite_differences():
    flight = Flight(np.random.default_rng(1))
    flight.advance()
    flight.image()
    f, camera = flight.filter, flight.camera()
    sight = f.project_rocks(camera)
    step = 1e-5
    for column, k in enumerate([0, 1, 2, 9, 10, 11]):
        error = np.zeros(15)
        error[k] = step
        ahead, behind = (shifted(f, e).project_rocks(camera, f.xyz).pixel for e in (error, -error))
        slope = (ahead - behind) / (2 * step)
        assert sight.jacobian_by_pose[:, :, column] == pytest.approx(slope, rel=1e-5, abs=1e-4)
    for axis in range(3):
        move = np.zeros(3)
        move[axis] = 1e-4
        slope = (
            f.project_rocks(camera, f.xyz + move).pixel
            - f.project_rocks(camera, f.xyz - move).pixel
        ) / 2e-4
        assert sight.jacobian_by_rock[:, :, axis] == pytest.approx(slope, rel=1e-5, abs=1e-6)


def test_updates_equal_a_dense_filter():
    """An EKF of filterpy with 16 + 4 n states and scalar updates gives the same."""
    flight = Flight(np.random.default_rng(2), rocks=4, ground=TerrainPrior(0.0, 3.0, 0.1))
    flight.advance()
    flight.image()
    flight.advance()
    f, camera = flight.filter, flight.camera()
    n = f.count
    size = 16 + 4 * n
    # Order of the dense state, Eq. 1: lander, ground, then x, y, z, r of each rock.
    place = np.concatenate((np.arange(16), (16 + 4 * np.arange(n)[:, None] + [0, 1, 2]).ravel()))
    dense = ExtendedKalmanFilter(size, 1)
    dense.x = np.zeros(size)
    dense.P = np.zeros((size, size))
    dense.P[np.ix_(place, place)] = f.covariance
    dense.P[19::4, 19::4] = np.diag(f.radius_variance)
    sight = f.project_rocks(camera)
    pixel, covariance, radius, variance = flight.look(camera)
    before = (f.inertial.position.copy(), f.xyz.copy(), f.radius.copy())
    rows, values, noises = [], [], []
    for j in range(n):
        for axis in range(2):
            h = np.zeros(size)
            h[[0, 1, 2, 9, 10, 11]] = sight.jacobian_by_pose[j, axis]
            h[16 + 4 * j : 19 + 4 * j] = sight.jacobian_by_rock[j, axis]
            rows.append(h)
            values.append(pixel[j, axis] - sight.pixel[j, axis])
            noises.append(covariance[j, axis, axis])
        h = np.zeros(size)
        h[19 + 4 * j] = 1.0
        rows.append(h)
        values.append(radius[j] - f.radius[j])
        noises.append(variance[j])
    for h, z, r in zip(rows, values, noises, strict=True):
        dense.update(
            np.array([z]),
            lambda x, h=h: h[None],
            lambda x, h=h: np.array([h @ x]),
            R=np.array([[r]]),
        )
    f.update_rocks(np.arange(n), sight, pixel, covariance, radius, variance)
    assert f.covariance == pytest.approx(dense.P[np.ix_(place, place)], rel=1e-7, abs=1e-10)
    assert f.radius_variance == pytest.approx(np.diag(dense.P)[19::4])
    assert f.inertial.position - before[0] == pytest.approx(dense.x[:3], abs=1e-9)
    assert (f.xyz - before[1]).ravel() == pytest.approx(dense.x[place[16:]], abs=1e-9)
    assert f.radius - before[2] == pytest.approx(dense.x[19::4], abs=1e-12)


def test_births_carry_the_full_cross_covariance():
    """Monte Carlo over pose and pixel errors gives the covariance that `add` writes."""
    rng = np.random.default_rng(3)
    flight = Flight(rng, rocks=2)
    f, camera = flight.filter, flight.camera()
    pixel, covariance, radius, variance = flight.look(camera)
    centre = flight.ground_of(pixel, camera)
    f.add(camera, centre, covariance, radius, variance)
    draws = np.linalg.cholesky(f.covariance[:15, :15]) @ rng.standard_normal((15, 4000))
    base = f.inertial
    found = np.empty((4000, 6))
    for k in range(4000):
        flight.filter = shifted(f, draws[:, k])
        noisy = pixel + flight.pixel_sigma * rng.standard_normal(pixel.shape)
        found[k] = (flight.ground_of(noisy, camera) - centre).ravel()
    flight.filter = f
    assert f.inertial is base
    sample = np.cov(np.vstack((draws, found.T)))
    # Rock heights on known terrain have no error.
    level = np.r_[0:17, 18:20]
    sample, p = sample[np.ix_(level, level)], f.covariance[np.ix_(level, level)]
    scale = np.sqrt(np.diag(p))
    correlation = p / np.outer(scale, scale)
    assert sample / np.outer(scale, scale) == pytest.approx(correlation, abs=0.12)


@pytest.mark.parametrize("seed", range(6))
def test_frozen_rocks_follow_schmidt_filter(seed):
    """Images and ranges against Joseph's form with zero gains of frozen rocks."""
    rng = np.random.default_rng(seed)
    flight = Flight(rng, rocks=9)
    flight.advance()
    flight.image()
    f = flight.filter
    for _ in range(3):
        flight.advance()
        is_frozen = rng.permutation(9) < rng.integers(5, 9)
        f.freeze(is_frozen)
        camera = flight.camera()
        sight = f.project_rocks(camera)
        pixel, covariance, radius, variance = flight.look(camera)
        index = np.flatnonzero(~is_frozen)
        h = np.zeros((2 * len(index), 42))
        for k, j in enumerate(index):
            h[2 * k : 2 * k + 2, [0, 1, 2, 9, 10, 11]] = sight.jacobian_by_pose[j]
            h[2 * k : 2 * k + 2, 15 + 3 * j : 18 + 3 * j] = sight.jacobian_by_rock[j]
        r = flight.pixel_sigma**2 * np.eye(len(h))
        states = np.concatenate((np.arange(15), (15 + 3 * index[:, None] + [0, 1, 2]).ravel()))
        gain, expected = consider_update(f.covariance, h, r, states)
        moved = gain @ (pixel[index] - sight.pixel[index]).ravel()
        before = f.xyz.copy()
        f.update_rocks(
            index, sight, pixel[index], covariance[index], radius[index], variance[index]
        )
        assert f.covariance == pytest.approx(expected, rel=1e-7, abs=1e-11)
        assert (f.xyz - before).ravel() == pytest.approx(moved[15:], abs=1e-9)
        assert np.array_equal(f.xyz[is_frozen], before[is_frozen])
        before, p = f.xyz.copy(), f.covariance.copy()
        flight.range()
        assert np.array_equal(f.xyz[is_frozen], before[is_frozen])
        assert np.array_equal(f.covariance, f.covariance.T)
        resting = 15 + 3 * np.flatnonzero(is_frozen)[:, None] + np.arange(3)
        own = np.ix_(resting.ravel(), resting.ravel())
        assert np.array_equal(f.covariance[own], p[own])


@pytest.mark.statistical
@sample_sizes(10, 50)
@pytest.mark.parametrize("resting", [False, True], ids=["all corrected", "some at rest"])
def test_nees_and_nis_are_consistent_over_flights(resting, count):
    seconds = 12.0
    nees, lander, nis = Consistency(), Consistency(), Consistency()
    for k in range(count):
        flight = Flight(np.random.default_rng(100 + k), rocks=8)
        if resting:
            flight.resting = np.random.default_rng(k)
        for value, degrees in fly(flight, seconds):
            nis = nis.plus(value, degrees)
        error, p = flight.error(), flight.filter.covariance
        # Rock heights on known terrain have no error.
        level = np.concatenate((np.arange(15), (15 + 3 * np.arange(8)[:, None] + [0, 1]).ravel()))
        nees = nees.plus(normalised_squared_error(error[level], p[np.ix_(level, level)]), 31)
        lander = lander.plus(normalised_squared_error(error[:15], p[:15, :15]), 15)
    for found in (nees, lander, nis):
        low, high = ratio_bounds(found.degrees)
        assert low < found.ratio < high


@sample_sizes(2_000, 10_000)
@pytest.mark.parametrize("resting", [False, True], ids=["all corrected", "some at rest"])
def test_covariance_stays_sound_over_thousands_of_updates(resting, count):
    flight = Flight(np.random.default_rng(5), rocks=6)
    flight.advance()
    flight.image()
    camera = flight.camera()
    f = flight.filter
    for k in range(count // 2):
        if resting:
            f.freeze(np.roll([True, True, True, True, False, False], k // 7))
        pixel, covariance, radius, variance = flight.look(camera)
        f.update_rocks(np.arange(6), f.project_rocks(camera), pixel, covariance, radius, variance)
        flight.range()
    p = f.covariance
    assert np.abs(p - p.T).max() <= 1e-12 * np.abs(p).max()
    level = np.flatnonzero(np.arange(len(p)) % 3 != 2 - 15 % 3)
    level = np.union1d(level, np.arange(15))
    assert np.linalg.eigvalsh(p[np.ix_(level, level)]).min() > 0.0
    assert np.linalg.norm(f.inertial.attitude) == pytest.approx(1.0, abs=1e-12)
    assert (f.radius_variance > 0.0).all()


def test_removing_a_rock_leaves_the_others_as_they_were():
    flight = Flight(np.random.default_rng(6), rocks=5)
    flight.advance()
    flight.image()
    f = flight.filter
    p, xyz = f.covariance.copy(), f.xyz.copy()
    keep = f.remove(np.array([1, 3]))  # the last rock takes the first free index
    rows = np.concatenate((np.arange(15), (15 + 3 * keep[:, None] + [0, 1, 2]).ravel()))
    assert keep.tolist() == [0, 4, 2]
    assert np.array_equal(f.covariance, p[np.ix_(rows, rows)])
    assert np.array_equal(f.xyz, xyz[keep])


def test_missing_samples_increase_covariance_and_images_reduce_it():
    flight = Flight(np.random.default_rng(7))
    fly(flight, 4.0)
    f = flight.filter
    before = np.trace(f.covariance[3:6, 3:6])
    # Two seconds without samples at a constant rate and force.
    start = f.inertial.position.copy(), f.inertial.velocity.copy()
    f.propagate(np.full((200, 3), np.nan), np.full((200, 3), np.nan))
    assert np.trace(f.covariance[3:6, 3:6]) > 10.0 * before
    assert f.inertial.position == pytest.approx(start[0] + 2.0 * start[1], abs=1.5)
    real, flight.filter = f, RockFilter.of(StrapdownState(*start, flight.attitude, GRAVITY))
    flight.advance(200)
    flight.filter = real
    fly(flight, 2.0)
    assert np.isfinite(f.covariance).all()
    error = flight.error()
    assert abs(error[:3]) == pytest.approx(0.0, abs=4.0 * np.sqrt(f.covariance[:3, :3].max()))


@pytest.mark.parametrize("reading", [np.nan, np.inf, -5.0, 1e6, 0.0])
def test_a_wrong_altitude_changes_nothing(reading):
    flight = Flight(np.random.default_rng(8))
    f = Navigator(
        flight.filter.inertial, StartSigmas(), terrain_prior=TerrainPrior(0.0, 3.0), rocks=True
    )
    p, z = f.covariance.copy(), f.inertial.position.copy()
    f.take("altimeter", AltimeterReading(1.0, reading, 1.0), 1.0)
    assert np.array_equal(f.covariance, p)
    assert np.array_equal(f.inertial.position, z)


def test_closed_forms_of_two_rows():
    rng = np.random.default_rng(4)
    root = rng.standard_normal((500, 2, 2))
    square, offset = root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(2), rng.normal(size=(500, 2))
    assert matrix_2x2.invert_2x2(root) == pytest.approx(np.linalg.inv(root), rel=1e-9, abs=1e-9)
    assert matrix_2x2.largest_eigenvalue_2x2(square) == pytest.approx(
        np.linalg.eigvalsh(square)[:, 1]
    )
    distance = [v @ np.linalg.solve(a, v) for v, a in zip(offset, square, strict=True)]
    assert matrix_2x2.squared_mahalanobis_2x2(offset, square) == pytest.approx(distance)


@pytest.fixture
def sloped():
    """Return a filter over uneven terrain with four rocks observed once."""
    flight = Flight(np.random.default_rng(11), rocks=4, ground=TerrainPrior(0.0, 3.0, 0.1))
    flight.advance()
    flight.image()
    return flight


def test_heights_of_new_rocks_differ_as_the_terrain_does(sloped):
    """Variances of height differences: 0.1^2 x 10 m a metre between them, and 5 cm each."""
    f = sloped.filter
    z = np.append(15, f.state.head + 3 * np.arange(4) + 2)  # the terrain below the lander first
    places = np.vstack((f.inertial.position[:2], f.xy))
    away = np.linalg.norm(places[:, None] - places[None], axis=-1)
    p = f.covariance[np.ix_(z, z)]
    found = np.diag(p)[:, None] + np.diag(p)[None] - 2.0 * p
    expected = 0.1 * away + 2.0 * 0.05**2 * (away > 0.0)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert p[0, 0] == pytest.approx(9.0 + 0.1 * np.hypot(0.9, 0.2), rel=0.01)


def test_a_new_rock_has_the_error_of_its_height_along_the_line_of_sight(sloped):
    f = sloped.filter
    i = f.state.head + 3 * np.arange(4)
    eye = f.inertial.position
    for k in range(4):
        lean = (f.xyz[k, :2] - eye[:2]) / (f.xyz[k, 2] - eye[2])
        x, y, z = i[k], i[k] + 1, i[k] + 2
        per_metre = f.covariance[[x, y], z] / f.covariance[z, z]
        assert per_metre == pytest.approx(lean, abs=1e-6)


@pytest.mark.statistical
@sample_sizes(8, 30)
def test_flights_over_terrain_that_rises_and_falls_are_consistent(count):
    nees, lander = Consistency(), Consistency()
    for k in range(count):
        flight = Flight(np.random.default_rng(300 + k), rocks=8, ground=TerrainPrior(0.0, 3.0, 0.1))
        flight.draw_heights(3.0, 0.1)
        fly(flight, 8.0, ranges=False)
        error, p = flight.error(), flight.filter.covariance
        rocks = 16 + np.arange(24)
        columns = np.concatenate((np.arange(15), rocks))
        nees = nees.plus(normalised_squared_error(error, p[np.ix_(columns, columns)]), 39)
        lander = lander.plus(normalised_squared_error(error[:15], p[:15, :15]), 15)
    for found in (nees, lander):
        low, high = ratio_bounds(found.degrees)
        assert low < found.ratio < high
