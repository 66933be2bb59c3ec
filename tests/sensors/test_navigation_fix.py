from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.sensors.navigation_fix import NavigationFixErrors
from lunarsim.vehicle import State
from lunarsim.world import World
from tests.chance import ratio_bounds
from tests.worlds import flat_terrain

STATE = State(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1400.0)


WORLD = World(flat_terrain(), 1.622)


def fixes(budget: NavigationFixErrors, seed: int, times) -> list:
    rng = np.random.default_rng(seed)
    instrument = budget.build(rng, 0.01)
    return [instrument.measure(WORLD, STATE, float(t), rng) for t in times]


def errors(count: int, time: float, budget: NavigationFixErrors) -> np.ndarray:
    """Position (3), velocity (3) and attitude (3) errors of `count` flights."""
    out = []
    for seed in range(count):
        e = fixes(budget, seed, np.arange(0.0, time + 1.0, 5.0))[-1]
        turn = quat_to_rotation_vector(quat_multiply(e.attitude, quat_conjugate(STATE.attitude)))
        out.append(np.concatenate((e.position, e.velocity, turn)))
    return np.array(out)


@pytest.mark.statistical
def test_errors_have_the_stated_covariance():
    budget = NavigationFixErrors(2.0, 0.5, 20.0, 0.1, 0.01)
    e = errors(600, 200.0, budget)
    covariance = fixes(budget, 0, [0.0])[0].covariance
    nees = np.einsum("ni,ij,nj->n", e, np.linalg.inv(covariance), e)
    low, high = ratio_bounds(9 * 600)
    assert low < nees.mean() / 9.0 < high


@pytest.mark.parametrize("time", [0.0, 5.0, 20.0, 60.0])
def test_the_drift_has_grown_as_far_as_is_stated(time):
    """Without a constant offset, which would hide it: 3 x 400 errors at each time."""
    budget = NavigationFixErrors(0.0, 0.5, 40.0, 0.1, 0.01)
    off, stated = [], []
    for seed in range(400):
        fix = fixes(budget, seed, np.arange(0.0, time + 1.0, 5.0))[-1]
        off.append(np.concatenate((fix.position, fix.velocity)))
        stated.append(np.diag(fix.covariance)[:6])
    stated = np.array(stated)
    assert np.array_equal(stated, np.tile(stated[0], (400, 1)))
    found = np.mean(np.square(off), axis=0)
    assert found[:3].mean() == pytest.approx(0.25 * (1.0 - np.exp(-time / 20.0)), rel=0.13)
    assert stated[0, :3] == pytest.approx(0.25 * (1.0 - np.exp(-time / 20.0)))
    assert found[3:].mean() == pytest.approx(0.01, rel=0.13)


@pytest.mark.parametrize("step", [0.5, 2.0])
def test_errors_are_correlated_over_their_time_constant(step):
    budget = NavigationFixErrors(0.0, 1.0, 10.0, 0.3, 0.0)
    made = fixes(budget, 3, step * np.arange(30_000))[200:]
    lag = round(10.0 / step)
    for x, sigma in ((np.array([f.position for f in made]), 1.0),
                     (np.array([f.velocity for f in made]), 0.3)):  # fmt: skip
        # As many seconds at either step: the error of these means is 10 s over them.
        alike = np.mean(x[lag:] * x[:-lag]) / np.mean(x**2)
        assert alike == pytest.approx(np.exp(-1.0), abs=0.05)
        assert np.std(x) == pytest.approx(sigma, rel=0.05)


def test_no_errors_is_the_truth():
    (e,) = fixes(NavigationFixErrors(0, 0, 1, 0, 0), 1, [3.0])
    assert e.time == 3.0
    assert np.array_equal(e.position, STATE.position)
    assert np.allclose(e.attitude, STATE.attitude)


def test_negative_budget_is_refused():
    with pytest.raises(InputError, match=r"navigation\.velocity"):
        NavigationFixErrors(velocity=-1.0)
    with pytest.raises(InputError, match=r"navigation\.drift_time"):
        NavigationFixErrors(drift_time=0.0)


def test_two_fixes_of_an_instant_are_the_same():
    first, again = fixes(NavigationFixErrors(), 2, [1.0, 1.0])
    assert np.array_equal(first.position, again.position)
    assert np.array_equal(first.velocity, again.velocity)
