from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.guidance.command_limits import PositionCorrectionLimiter
from lunarsim.onboard.navigation.estimate import Estimate

SPEED = np.array([3.0, -1.0, -2.0])


def estimate(time: float, step: float = 0.0) -> Estimate:
    """A straight flight whose place moves by `step` m to the east after 1 s."""
    moved = np.array([step if time > 1.0 else 0.0, 0.0, 0.0])
    return Estimate(
        time, time * SPEED + moved, SPEED, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1500.0,
        np.eye(9),
    )  # fmt: skip


def flown(left: float, step: float, until: float = 4.0, cycle: float = 0.1) -> np.ndarray:
    steady = PositionCorrectionLimiter()
    times = np.arange(0.0, until, cycle)
    return np.array([steady.limit(estimate(t, step), left).position - t * SPEED for t in times])


def test_a_step_of_the_place_is_taken_up_slowly_near_the_end():
    off = flown(2.0, 1.0)
    np.testing.assert_allclose(off[:10], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(off[11:, 0]), 0.015, atol=1e-12)
    np.testing.assert_allclose(off[:, 1:], 0.0, atol=1e-12)


def test_a_step_is_taken_up_whole_in_the_end():
    assert flown(2.0, 0.2)[-1, 0] == pytest.approx(0.2, abs=1e-12)


def test_far_from_the_end_the_place_is_taken_as_it_is():
    off = flown(20.0, 1.0)
    np.testing.assert_allclose(off[11:, 0], 1.0, atol=1e-12)


def test_height_and_velocity_are_taken_as_they_are():
    steady = PositionCorrectionLimiter()
    steady.limit(estimate(0.0), 1.0)
    later = Estimate(
        0.1, np.array([9.0, 9.0, 7.0]), np.array([1.0, 2.0, 3.0]),
        np.array([0.0, 0.0, 0.0, 1.0]), np.ones(3), 1400.0, np.eye(9),
    )  # fmt: skip
    found = steady.limit(later, 1.0)
    assert found.position[2] == 7.0
    np.testing.assert_array_equal(found.velocity, later.velocity)
    np.testing.assert_array_equal(found.rate, later.rate)
    assert found.mass == later.mass


def test_small_corrections_pass_unchanged():
    steady = PositionCorrectionLimiter()
    for n in range(20):
        given = estimate(0.1 * n)
        given.position[0] += 0.001 * (-1) ** n
        np.testing.assert_array_equal(steady.limit(given, 2.0).position, given.position)


def test_a_step_is_taken_up_as_fast_in_shorter_cycles():
    off = flown(2.0, 1.0, cycle=0.05)
    np.testing.assert_allclose(np.diff(off[22:, 0]), 0.15 * 0.05, atol=1e-12)


@pytest.mark.parametrize(("left", "slow"), [(0.0, True), (11.9, True), (12.1, False)])
def test_it_is_slow_within_twelve_seconds_of_the_end_and_after_it(left, slow):
    assert (flown(left, 1.0)[11, 0] < 0.1) == slow


def test_a_step_aside_is_taken_up_along_itself():
    steady = PositionCorrectionLimiter()
    for n in range(3):
        given = estimate(0.1 * n)
        given.position[:2] += 3.0 * (n > 1), 4.0 * (n > 1)
        found = steady.limit(given, 1.0).position - 0.1 * n * SPEED
    np.testing.assert_allclose(found[:2], 0.015 * np.array([0.6, 0.8]), atol=1e-12)


@pytest.mark.parametrize(("left", "speed"), [(0.0, 0.15), (2.4, 0.15), (5.0, 0.3), (10.0, 0.6)])
def test_it_is_taken_up_faster_while_there_is_time_to_fly_it_out(left, speed):
    np.testing.assert_allclose(np.diff(flown(left, 3.0)[11:, 0]), 0.1 * speed, atol=1e-12)
