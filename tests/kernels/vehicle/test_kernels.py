"""Compiled motion of the body, against SciPy's rotations and integrator."""

import numpy as np
import pytest

from lunarsim.vehicle import _kernels as kernels
from lunarsim.vehicle.dynamics import PLAIN_RIG
from tests.reference import dynamics as plain

DRY, WET = 900.0, 1500.0
I_DRY, I_WET = np.array([700.0, 800.0, 1100.0]), np.array([900.0, 1500.0, 1900.0])


def state(rng):
    q = rng.standard_normal(4)
    return np.concatenate(
        (rng.normal(0.0, 100.0, 3), rng.normal(0.0, 20.0, 3), q / np.linalg.norm(q),
         rng.normal(0.0, 0.5, 3), [rng.uniform(1000.0, 1450.0), rng.uniform(1000.0, 5000.0)])
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_rate_of_change(seed, lag):
    rng = np.random.default_rng(seed)
    y, out = state(rng), np.empty(15)
    args = (4000.0, rng.normal(0.0, 50.0, 3), 1.6, 3000.0, lag, DRY, WET, I_DRY, I_WET)
    kernels.derivative(y, out, *args, PLAIN_RIG)
    assert out == pytest.approx(plain.rate_of_change(y, *args), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_a_second_of_steps(seed, lag):
    rng = np.random.default_rng(seed)
    y, work = state(rng), np.empty((5, 15))
    torque, command = rng.normal(0.0, 50.0, 3), 3500.0
    figures = np.array([1.6, 3000.0, lag, DRY, WET])
    start = y.copy()
    if lag == 0.0:
        start[14] = command
    wanted = plain.moved(start, 1.0, command, torque, 1.6, 3000.0, lag, DRY, WET, I_DRY, I_WET)
    for _ in range(200):
        kernels.advance_body(
            y, 0.005, command, torque, figures, np.array([I_DRY, I_WET]), PLAIN_RIG, work
        )
    assert y == pytest.approx(wanted, rel=1e-7, abs=1e-8)


def test_empty_tanks_give_no_thrust_and_keep_the_dry_mass():
    rng = np.random.default_rng(1)
    figures, inertia = np.array([1.6, 3000.0, 0.3, DRY, WET]), np.array([I_DRY, I_WET])
    for left in (0.0, 1e-3):
        y = state(rng)
        y[13] = DRY + left
        speed = y[3:6].copy()
        kernels.advance_body(
            y, 0.01, 3500.0, np.zeros(3), figures, inertia, PLAIN_RIG, np.empty((5, 15))
        )
        assert y[13] == DRY
        if left == 0.0:
            assert y[14] == 0.0
            assert y[3:6] == pytest.approx(speed - [0.0, 0.0, 0.016], rel=1e-12)
        else:
            assert y[14] > 0.0


@pytest.mark.parametrize("seed", range(4))
def test_ideal_attitude_goes_along_the_shortest_arc(seed):
    rng = np.random.default_rng(seed)
    y, target = state(rng), state(rng)[6:10]
    figures, dt, slew = np.array([1.6, 3000.0, 0.3, DRY, WET]), 0.05, 1.0
    work = np.empty((5, 15))
    expected = y.copy()
    history = kernels.advance_ideal(
        y, 80, dt, 3500.0, target, slew, figures, np.array([I_DRY, I_WET]), PLAIN_RIG
    )
    for found in history:
        q, arc = plain.turned_towards(expected[6:10], target, slew * dt)
        expected[10:13] = 0.0
        kernels.advance_body(
            expected,
            dt,
            3500.0,
            np.zeros(3),
            figures,
            np.array([I_DRY, I_WET]),
            PLAIN_RIG,
            work,
        )
        assert found[:6] == pytest.approx(expected[:6], rel=1e-9)
        assert found[13:] == pytest.approx(expected[13:], rel=1e-9)
        assert abs(found[6:10] @ q) == pytest.approx(1.0, abs=1e-12)
        assert found[10:13] == pytest.approx(arc / dt, abs=1e-6)
        expected[6:10] = q
    assert abs(history[-1, 6:10] @ target) == pytest.approx(1.0, abs=1e-9)
    assert np.array_equal(history[-1], y)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_bodies_side_by_side_move_as_each_alone(count):
    """To the bits; one has empty tanks, and one an attitude whose norm has drifted."""
    rng = np.random.default_rng(count)
    each = [state(rng) for _ in range(count)]
    each[0][13], each[-1][6:10] = DRY if count > 1 else 1200.0, 1.001 * each[-1][6:10]
    bodies = np.ascontiguousarray(np.array(each).T)
    asked, torque = rng.uniform(1000.0, 5000.0, count), rng.normal(0.0, 50.0, (3, count))
    # Each body has figures of its own.
    one, inertia = np.array([[1.6], [3000.0], [0.3], [DRY], [WET]]), np.array([I_DRY, I_WET])
    figures = one * (1.0 + 1e-4 * np.arange(count))
    wanted = asked.copy()
    for _ in range(5):
        kernels.advance_bodies(
            bodies, 0.01, asked, torque, figures, inertia, PLAIN_RIG, np.empty((5, 15, count))
        )
        for n, y in enumerate(each):
            kernels.advance_body(
                y, 0.01, wanted[n], torque[:, n], figures[:, n].copy(), inertia, PLAIN_RIG,
                np.empty((5, 15)),
            )  # fmt: skip
    assert np.array_equal(bodies.T, np.array(each))
    assert np.linalg.norm(bodies[6:10], axis=0) == pytest.approx(np.ones(count), abs=1e-15)
    assert (asked == 0.0).tolist() == [n == 0 and count > 1 for n in range(count)]
