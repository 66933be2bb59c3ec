"""Test empty images, rotating views and inflations of lander and rocks."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.instruments import LidarInstrument
from lunarsim.onboard.navigation.aiding_measurements import AidingMeasurements, aiding_blocks
from lunarsim.onboard.navigation.error_state import POSE, REFERENCE_POSE, ErrorState, UpdateOutcome
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.innovation_monitor import RockCorrection
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior
from tests.rock_scene import GRAVITY, Flight


@pytest.mark.parametrize("bad", ["pixel", "covariance", "singular"])
def test_rock_with_non_finite_pixel_is_ignored(bad):
    one, other = (Flight(np.random.default_rng(12), rocks=5) for _ in range(2))
    for flight in (one, other):
        flight.advance()
        flight.image()
        flight.advance()
    camera = one.camera()
    pixel, covariance, radius, variance = one.look(camera)
    left = np.array([0, 1, 3, 4])
    other.filter.update_rocks(
        left, other.filter.project_rocks(camera), pixel[left], covariance[left], radius[left],
        variance[left],
    )  # fmt: skip
    if bad == "pixel":
        pixel[2, 1] = np.nan
    elif bad == "covariance":
        covariance[2, 0, 0] = np.inf
    else:
        covariance[2] = 0.0
    found = one.filter.update_rocks(
        np.arange(5), one.filter.project_rocks(camera), pixel, covariance, radius, variance
    )
    assert found.dof == 8
    assert np.array_equal(one.filter.covariance, other.filter.covariance)
    assert np.array_equal(one.filter.xyz, other.filter.xyz)


@pytest.mark.parametrize(("radius", "variance"), [(np.nan, 0.04), (0.5, np.nan), (0.5, 0.0)])
def test_non_finite_radius_is_ignored(radius, variance):
    flight = Flight(np.random.default_rng(13), rocks=3)
    flight.image()
    f = flight.filter
    before = f.radius.copy(), f.radius_variance.copy()
    f.update_radii(np.array([1]), np.array([radius]), np.array([variance]))
    assert np.array_equal(f.radius, before[0]) and np.array_equal(f.radius_variance, before[1])
    f.update_radii(np.array([1]), np.array([0.5]), np.array([0.04]))
    assert f.radius_variance[1] < before[1][1]


def test_an_image_of_nothing_changes_nothing():
    flight = Flight(np.random.default_rng(14), rocks=3)
    flight.image()
    f, p = flight.filter, flight.filter.covariance.copy()
    none = np.empty(0)
    found = f.update_rocks(
        np.empty(0, int), f.project_rocks(flight.camera()), np.empty((0, 2)), np.empty((0, 2,
        2)), none,
        none,
    )  # fmt: skip
    assert (found.nis, found.dof, found.is_accepted) == (0.0, 0, False)
    assert np.array_equal(f.covariance, p)


def test_shifted_image_is_rejected():
    flight = Flight(np.random.default_rng(15), rocks=9)
    flight.advance()
    flight.image()
    camera, f = flight.camera(), flight.filter
    for _ in range(5):
        flight.image()
    p, xyz = f.covariance.copy(), f.xyz.copy()
    pixel, covariance, radius, variance = flight.look(camera)
    rng = np.random.default_rng(0)
    wrong = pixel + 40.0 * rng.standard_normal(pixel.shape)
    found = f.update_rocks(
        np.arange(9), f.project_rocks(camera), wrong, covariance, radius, variance, gate=3.0
    )
    assert not found.is_accepted and found.nis > 54.0
    assert np.array_equal(f.covariance, p) and np.array_equal(f.xyz, xyz)


def test_centres_wander_along_the_sun_as_the_view_turns():
    flight = Flight(np.random.default_rng(16), rocks=2)
    flight.image()
    f = flight.filter
    sun = np.array([0.6, 0.0, 0.8])
    f.add_view_noise(sun, 0.3, 0.1, 0.2)
    p = f.covariance.copy()
    before = f.inertial.position.copy()
    # Small rotations accumulate until the threshold.
    for move in ([0.5, 0.0, -1.0], [39.5, -25.0, -39.0]):
        assert np.array_equal(p, f.covariance)
        f.inertial.correct(np.concatenate((move, np.zeros(12))))
        f.add_view_noise(sun, 0.3, 0.1, 0.2)
    grown = f.covariance - p
    angles = []
    for rock in f.xyz:
        a, b = rock - before, rock - f.inertial.position
        angles.append(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
    step = np.sqrt(angles) * f.radius
    assert grown[15, 15] == pytest.approx((0.3**2 + 0.2**2) * step[0] ** 2)
    assert grown[18, 18] == pytest.approx((0.3**2 + 0.2**2) * step[1] ** 2)
    assert grown[16, 16] == pytest.approx((0.1 * step[0]) ** 2)
    assert grown[19, 19] == pytest.approx((0.1 * step[1]) ** 2)
    assert grown[15, 18] == grown[18, 15] == pytest.approx(0.2**2 * step[0] * step[1])
    grown[np.ix_([15, 18], [15, 18])] = 0.0
    grown[[16, 19], [16, 19]] = 0.0
    assert np.array_equal(grown, np.zeros_like(grown))


def test_a_camera_of_other_pixels_shows_rocks_off_by_what_the_coarser_ones_span():
    """A change of cameras acts like a range change with the same pixel footprint."""
    flight = Flight(np.random.default_rng(16), rocks=2)
    flight.image()
    f, sun = flight.filter, np.array([0.6, 0.0, 0.8])
    wide, narrow = 2e-3, 0.5e-3
    f.add_view_noise(sun, 0.0, 0.0, 0.0, scale_sigma=0.9, pixel_size=wide)
    p = f.covariance.copy()
    for pixel, times in ((wide, 0), (narrow, 1), (narrow, 1), (wide, 2)):
        f.add_view_noise(sun, 0.0, 0.0, 0.0, scale_sigma=0.9, pixel_size=pixel)
        grown = f.covariance - p
        span = wide * np.linalg.norm(f.xyz - f.inertial.position, axis=1)
        expected = times * 0.9**2 * np.log(4.0) * span**2
        assert np.diag(grown)[[15, 18]] == pytest.approx(expected, abs=1e-15)
        assert grown[15, 18] == pytest.approx(np.sqrt(expected.prod()), abs=1e-15)
        assert np.count_nonzero(grown) == (4 if times else 0)


def test_rocks_stand_behind_the_blocks_of_a_state_that_others_share():
    start = Flight(np.random.default_rng(17)).filter.inertial
    level, events = TerrainPrior(0.0, 3.0, 0.1), []
    state = ErrorState(start, blocks={**aiding_blocks({}, level), "scan": np.eye(6)})
    f = RockFilter(state, AidingMeasurements(state, {}, level, events))
    shared = state.covariance.copy()
    f.add_known(np.array([[1.0, 2.0], [5.0, -3.0]]), np.array([0.5, 0.4]), np.ones(2), np.ones(2))
    assert np.array_equal(state.covariance[:22, :22], shared)
    assert np.diag(state.covariance)[22:25] == pytest.approx([0.25, 0.25, 9.0], rel=2.0)
    assert state.covariance[15, 24] == pytest.approx(9.0)  # follows the terrain
    state.measure([[1.0]], [15], [2.0], [1.0])
    assert f.terrain_height_below == pytest.approx(1.8)
    assert f.xyz[0, 2] == pytest.approx(1.8)
    with pytest.raises(InputError, match=r"state\.tail"):
        RockFilter(state, AidingMeasurements(state, {}, level, events))


def test_rock_alarm_inflates_reference_pose():
    """Otherwise the next scan would pull the lander back to the contradicted pose."""
    f = Navigator(
        StrapdownState([0.0, 0.0, 100.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0, 1.0], GRAVITY),
        StartSigmas(), instruments={"flash": LidarInstrument(np.pi)}, rocks=True,
    ).rocks  # fmt: skip
    for _ in range(3):
        f.propagate(np.zeros((100, 3)), np.tile([0.0, 0.0, 0.01 * GRAVITY], (100, 1)))
    f.state.clone(REFERENCE_POSE, POSE)
    key = f.state.block(REFERENCE_POSE)
    before, between = f.covariance.copy(), np.s_[key, POSE]
    for k in range(6):
        f.monitor_image("places", 0.2 * k, UpdateOutcome(900.0, 10, False))
    growth = np.diag(f.covariance)[key] / np.diag(before)[key]
    assert growth == pytest.approx(np.diag(f.covariance)[POSE] / np.diag(before)[POSE])
    assert (growth[:3] > 3.0).all()
    # The relative position of lander and scan does not change.
    assert f.covariance[between] == pytest.approx(f.covariance[key, key])


def test_alarm_inflates_lander_and_rocks():
    flight = Flight(np.random.default_rng(18), rocks=3)
    flight.advance()
    flight.image()
    f = flight.filter
    before = np.diag(f.covariance).copy()
    wrong = UpdateOutcome(900.0, 200, False)
    remedies = [f.monitor_image("places", 0.2 * k, wrong) for k in range(6)]
    assert remedies[-1] is RockCorrection.INFLATE and [e.name for e in f.events] == [
        "covariance-inflated"
    ]
    after = np.diag(f.covariance)
    assert after[3:6] == pytest.approx(4.5 * before[3:6], rel=1e-4)
    assert after[15:17] == pytest.approx(4.5 * before[15:17])
    assert np.array_equal(after[6:9], before[6:9])  # the biases of the inertial unit do not change
    assert not f.lost
