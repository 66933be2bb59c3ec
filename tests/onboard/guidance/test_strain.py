from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.guidance.command_limits import LimitViolationMonitor

MOST = (np.deg2rad(40.0), 5000.0)


def leaning(degrees: float, size: float = 3.0) -> np.ndarray:
    lean = np.deg2rad(degrees)
    return size * np.array([0.6 * np.sin(lean), -0.8 * np.sin(lean), np.cos(lean)])


def first(commands: list[np.ndarray], mass: float = 1000.0, start: float = 0.0) -> float | None:
    """Return when it is told first, commands coming ten times a second."""
    strain = LimitViolationMonitor()
    for n, wanted in enumerate(commands):
        if strain.exceeds_duration(wanted, mass, MOST, start + 0.1 * n):
            return round(0.1 * n, 6)
    return None


@pytest.mark.parametrize("start", [0.0, 31.7])
def test_leaning_too_far_for_half_a_second_is_reported(start):
    assert first([leaning(45.0)] * 20, start=start) == 0.5


def test_pushing_too_hard_is_reported():
    assert first([leaning(10.0, 5.2)] * 20) == 0.5
    assert first([leaning(10.0, 5.2)] * 20, mass=900.0) is None


def test_up_to_the_limits_is_nothing():
    assert first([leaning(40.0, 5.0)] * 50) is None


def test_what_comes_and_goes_is_nothing():
    assert first(([leaning(45.0)] * 5 + [leaning(39.0)]) * 10) is None


def test_it_starts_again_after_a_report():
    strain = LimitViolationMonitor()
    told = [n for n in range(30) if strain.exceeds_duration(leaning(60.0), 1000.0, MOST, 0.1 * n)]
    assert told == [5, 11, 17, 23, 29]


def test_thrust_downward_is_a_lean():
    assert first([np.array([0.0, 0.0, -1.0])] * 9) == 0.5
