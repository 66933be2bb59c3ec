"""Test navigation with the fixes of an external system."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector
from lunarsim.messages.briefing import InitialStateEstimate
from lunarsim.messages.measurements import AltimeterReading, InertialSamples, NavigationFix
from lunarsim.onboard.navigation.navigation_kinds import FixNavigation
from lunarsim.onboard.navigation.navigator import Navigator

TURN = quat_from_rotation_vector([0.1, 0.2, 0.3])
START = InitialStateEstimate(
    np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), TURN, 2.0, 0.3, 0.04
)


def test_before_the_first_fix_it_is_where_the_start_was():
    e = FixNavigation(START, 0.01).estimate(0.0, 1400.0)
    assert np.array_equal(e.position, START.position)
    assert np.array_equal(e.velocity, START.velocity)
    assert np.array_equal(e.attitude, TURN)
    assert np.diag(e.covariance) == pytest.approx(np.repeat([4.0, 0.09, 0.0016], 3))
    assert (e.time, e.mass) == (0.0, 1400.0)


def test_the_last_fix_is_the_estimate():
    navigation = FixNavigation(START, 0.01)
    for k in range(3):
        fix = NavigationFix(0.1 * k, np.full(3, k), np.full(3, -k), TURN, k * np.eye(9))
        navigation.take("fix", fix, 0.1 * k)
    e = navigation.estimate(0.25, 1300.0)
    assert np.array_equal(e.position, np.full(3, 2.0))
    assert np.array_equal(e.velocity, np.full(3, -2.0))
    assert np.array_equal(e.covariance, 2.0 * np.eye(9))
    assert np.array_equal(navigation.site_to_local.offset, np.zeros(3))
    assert navigation.events == []


def test_gyroscopes_give_the_rate_and_other_sensors_nothing():
    navigation = FixNavigation(START, 0.01)
    before = navigation.estimate(0.1, 1.0)
    navigation.take("radar", AltimeterReading(0.1, 100.0, 1.0), 0.1)
    after = navigation.estimate(0.1, 1.0)
    assert np.array_equal(before.position, after.position)
    assert np.array_equal(after.rate, np.zeros(3))
    angle = np.array([[9.0, 9.0, 9.0], [0.001, -0.002, 0.0005]])
    navigation.take("imu", InertialSamples(0.1, angle, np.zeros((2, 3))), 0.1)
    assert navigation.estimate(0.1, 1.0).rate == pytest.approx([0.1, -0.2, 0.05])


@pytest.mark.parametrize("part", ["position", "velocity", "attitude", "covariance"])
def test_non_finite_fix_is_ignored(part):
    navigation = FixNavigation(START, 0.01)
    good = NavigationFix(1.0, np.ones(3), np.ones(3), TURN, np.eye(9))
    navigation.take("fix", good, 1.0)
    navigation.take("fix", replace(good, time=1.1, **{part: getattr(good, part) * np.nan}), 1.1)
    e = navigation.estimate(1.1, 1.0)
    assert np.array_equal(e.position, np.ones(3))
    assert np.isfinite(e.covariance).all()
    assert not e.lost


def test_without_fixes_it_is_lost_until_one_comes():
    navigation = FixNavigation(START, 0.01)
    navigation.take("fix", NavigationFix(1.0, np.ones(3), np.ones(3), TURN, np.eye(9)), 1.0)
    assert not navigation.estimate(3.0, 1.0).lost
    assert navigation.estimate(3.1, 1.0).lost
    navigation.take("fix", NavigationFix(3.2, np.ones(3), np.ones(3), TURN, np.eye(9)), 3.2)
    assert not navigation.estimate(3.2, 1.0).lost


@pytest.mark.parametrize(
    "wrong",
    [
        {"attitude": np.zeros(4)},
        {"attitude": 1.5 * TURN},
        {"covariance": -np.eye(9)},
        {"time": 0.9},
        {"time": 7.0},
        {"time": np.nan},
    ],
)
def test_invalid_fix_changes_nothing(wrong):
    navigation = FixNavigation(START, 0.01)
    good = NavigationFix(1.0, np.ones(3), np.ones(3), TURN, np.eye(9))
    navigation.take("fix", good, 1.0)
    bad = replace(good, **({"time": 1.1, "position": np.zeros(3)} | wrong))
    navigation.take("fix", bad, 1.1)
    assert np.array_equal(navigation.estimate(1.1, 1.0).position, np.ones(3))
    assert navigation.estimate(3.1, 1.0).lost


@pytest.mark.parametrize("part", ["position", "velocity", "attitude", "covariance"])
def test_a_fix_of_another_shape_is_refused(part):
    good = NavigationFix(1.0, np.ones(3), np.ones(3), TURN, np.eye(9))
    with pytest.raises(InputError, match=f"fix.{part}"):
        FixNavigation(START, 0.01).take("fix", replace(good, **{part: np.ones(2)}), 1.0)


def test_samples_that_are_missing_leave_the_rate():
    navigation = FixNavigation(START, 0.01)
    angle = np.array([[0.001, 0.0, 0.0], [np.nan, np.nan, np.nan]])
    navigation.take("imu", InertialSamples(0.1, angle, np.zeros((2, 3))), 0.1)
    assert navigation.estimate(0.1, 1.0).rate == pytest.approx([0.1, 0.0, 0.0])
    navigation.take("imu", InertialSamples(0.2, np.zeros((0, 3)), np.zeros((0, 3))), 0.2)
    assert navigation.estimate(0.2, 1.0).rate == pytest.approx([0.1, 0.0, 0.0])


def test_fixes_do_not_move_the_place_in_steps():
    assert not FixNavigation.has_position_steps
    assert Navigator.has_position_steps
