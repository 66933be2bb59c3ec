from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.sensors.navigation_fix import ErrorBudget, NavigationErrorModel
from lunarsim.vehicle import State

STATE = State(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1400.0)


def errors(count: int, time: float, budget: ErrorBudget) -> np.ndarray:
    """Position (3), velocity (3) and attitude (3) errors of `count` flights."""
    out = []
    for seed in range(count):
        model = NavigationErrorModel(budget, np.random.default_rng(seed))
        for t in np.arange(0.0, time + 1.0, 5.0):
            e = model.update(STATE, float(t))
        turn = quat_to_rotation_vector(quat_multiply(e.attitude, quat_conjugate(STATE.attitude)))
        out.append(np.concatenate((e.position, e.velocity, turn)))
    return np.array(out)


def test_errors_have_the_stated_covariance():
    budget = ErrorBudget(2.0, 0.5, 20.0, 0.1, 0.01)
    e = errors(600, 200.0, budget)
    covariance = (
        NavigationErrorModel(budget, np.random.default_rng(0)).update(STATE, 0.0).covariance
    )
    nees = np.einsum("ni,ij,nj->n", e, np.linalg.inv(covariance), e)
    # Chi-square with 9 degrees of freedom: the mean of 600 lies within 9 +- 3 * sqrt(18 / 600).
    assert nees.mean() == pytest.approx(9.0, abs=0.52)


def test_drift_is_correlated_over_its_time_constant():
    budget = ErrorBudget(0.0, 1.0, 10.0, 0.0, 0.0)
    model = NavigationErrorModel(budget, np.random.default_rng(3))
    x = np.array([model.update(STATE, float(t)).position for t in range(30_000)])
    x = x[200:]
    lag = np.mean(x[10:] * x[:-10]) / np.mean(x**2)
    assert lag == pytest.approx(np.exp(-1.0), abs=0.03)
    assert np.std(x) == pytest.approx(1.0, abs=0.05)


def test_no_errors_is_the_truth():
    model = NavigationErrorModel(ErrorBudget(0, 0, 1, 0, 0), np.random.default_rng(1))
    e = model.update(STATE, 3.0)
    assert np.array_equal(e.position, STATE.position)
    assert np.allclose(e.attitude, STATE.attitude)


def test_negative_budget_is_refused():
    with pytest.raises(InputError, match=r"navigation\.velocity"):
        ErrorBudget(velocity=-1.0)
