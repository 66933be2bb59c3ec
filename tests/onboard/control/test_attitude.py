"""The laws alone: torques from errors and rates."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.control.attitude import IdealAttitude, ProportionalDerivative

INERTIA = np.array([1100.0, 1200.0, 1500.0])


def test_torques_are_those_of_a_damped_oscillator():
    """Torque over inertia is w^2 times the error less 2 d w times the rate, below the slew."""
    law = ProportionalDerivative(frequency=3.0, damping=0.8)
    error, rate = np.array([0.02, -0.03, 0.01]), np.array([0.004, 0.0, -0.02])
    wanted = INERTIA * (3.0**2 * error - 2.0 * 0.8 * 3.0 * rate)
    assert law.torque(error, rate, INERTIA) == pytest.approx(wanted)


def test_large_errors_ask_for_the_slew_and_no_more():
    law = ProportionalDerivative(slew_limit=0.2)
    error = np.array([2.0, -2.0, 3.0])
    at_slew = law.torque(error, np.array([0.2, -0.2, 0.2]), INERTIA)
    assert at_slew == pytest.approx(np.zeros(3), abs=1e-9)
    still = law.torque(error, np.zeros(3), INERTIA)
    assert still == pytest.approx(law.torque(10.0 * error, np.zeros(3), INERTIA))


def test_response_time_is_the_lag_behind_a_steady_turn():
    """Turning on at a rate w the error settles where the wanted rate is w."""
    law = ProportionalDerivative()
    rate = np.full(3, 0.03)
    error = law.response_time * rate
    assert law.torque(error, rate, INERTIA) == pytest.approx(np.zeros(3), abs=1e-9)


def test_an_ideal_actuator_needs_no_torque():
    law = IdealAttitude()
    assert not law.torques
    assert law.response_time == 0.0
    assert np.array_equal(law.torque(np.ones(3), np.ones(3), INERTIA), np.zeros(3))
