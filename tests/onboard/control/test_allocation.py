"""Allocation of torques to thrusters, against SciPy's linear programmes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog, nnls

from lunarsim.errors import InputError
from lunarsim.models.thrusters import Thrusters
from lunarsim.onboard.control.allocation import ThrusterAllocation


def odd_layout(seed: int, count: int = 10) -> Thrusters:
    """Return thrusters that sit and push anyhow, but can turn every way."""
    rng = np.random.default_rng(seed)
    while True:
        where, along = rng.uniform(-2.0, 2.0, (2, count, 3))
        try:
            return Thrusters(
                positions=tuple(map(tuple, where)), directions=tuple(map(tuple, along))
            )
        except InputError:
            continue


LAYOUTS = [Thrusters(), Thrusters(cluster_height=0.7), odd_layout(1), odd_layout(2)]


def totals(layout: Thrusters, allocation: ThrusterAllocation, torque) -> float:
    return float(allocation.group_thrust(np.asarray(torque)).sum())


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_other_thrusters_make_the_torque_with_less(layout):
    allocation = ThrusterAllocation(layout)
    columns = layout.torques.T / layout.force
    rng = np.random.default_rng(7)
    for torque in rng.normal(0.0, 10.0, (60, 3)):
        best = linprog(np.ones(layout.count), A_eq=columns, b_eq=torque)
        assert best.status == 0
        assert totals(layout, allocation, torque) == pytest.approx(best.fun, rel=1e-7)
        assert nnls(columns, torque)[1] < 1e-9


@pytest.mark.parametrize("layout", LAYOUTS)
def test_long_firings_give_the_torque_that_was_asked_for(layout):
    allocation = ThrusterAllocation(layout)
    rng = np.random.default_rng(3)
    period = 1.0
    for direction in rng.standard_normal((40, 3)):
        torque = 0.5 * allocation.authority.min() * direction / np.abs(direction).sum()
        on = allocation.on_times(torque, period)
        assert on.min() >= 0.0
        assert on.max() <= period
        error = np.abs(allocation.impulse(on) - torque * period)
        # Each of three groups errs by at most half of a shortest pulse.
        assert np.all(error <= 3 * 0.5 * layout.min_on_time * np.abs(layout.torques).max() + 1e-9)
        assert np.all((on == 0.0) | (on >= layout.min_on_time - 1e-12))


def test_too_much_is_made_less_in_the_same_direction():
    layout = Thrusters()
    allocation = ThrusterAllocation(layout)
    torque = np.array([3e4, -1e4, 5e3])
    given = allocation.impulse(allocation.on_times(torque, 1.0))
    assert given / np.linalg.norm(given) == pytest.approx(torque / np.linalg.norm(torque), abs=2e-2)
    # The greatest multiple that any firing of all thrusters reaches.
    columns = np.column_stack((layout.torques.T, -torque))
    most = linprog(
        [0.0] * 16 + [-1.0], A_eq=columns, b_eq=np.zeros(3), bounds=[(0, 1)] * 16 + [(0, None)]
    )
    assert np.linalg.norm(given) == pytest.approx(most.x[-1] * np.linalg.norm(torque), rel=0.02)


def test_the_authority_of_four_clusters_is_all_that_they_have():
    layout = Thrusters()
    allocation = ThrusterAllocation(layout)
    arm = layout.cluster_radius / np.sqrt(2.0)
    assert allocation.authority == pytest.approx([4 * 60.0 * arm] * 3)
    # Pitch and roll take two thrusters, yaw one, of 20 ms.
    assert allocation.min_impulse == pytest.approx(
        [2 * 60.0 * arm * 0.02, 2 * 60.0 * arm * 0.02, 60.0 * arm * 0.02]
    )


def test_short_firings_go_round_the_thrusters_of_a_group():
    allocation = ThrusterAllocation(Thrusters())
    torque = np.array([0.0, 0.0, allocation.min_impulse[2] * 1.2 / 0.1])
    used = [tuple(np.flatnonzero(allocation.on_times(torque, 0.1))) for _ in range(8)]
    assert all(len(one) == 1 for one in used)
    assert len(set(used)) == 4


def test_a_torque_that_is_no_number_is_refused():
    with pytest.raises(InputError, match="finite"):
        ThrusterAllocation(Thrusters()).on_times(np.array([np.nan, 0.0, 0.0]), 0.1)


ONE_SIDED = [(odd_layout(1), ()), (odd_layout(1), (2,)), (odd_layout(2), (1,)), (Thrusters(), (1,))]


@pytest.mark.parametrize(("layout", "out"), ONE_SIDED)
def test_authority_and_least_impulse_hold_in_both_senses(layout, out):
    """What is held either way, and the shortest pulses that make a clean turn either way."""
    allocation, period = ThrusterAllocation(layout, out), 1.0
    assert allocation.spans_all_torques
    exact = np.zeros((3, 2), bool)
    clean = np.zeros((3, 2), bool)
    for axis in range(3):
        for n, sense in enumerate((1.0, -1.0)):
            along = sense * np.eye(3)[axis]

            def given(torque):
                return allocation.impulse(allocation.on_times(torque, period))

            most = allocation.authority[axis] * along
            assert given(0.999 * most) == pytest.approx(0.999 * most, rel=1e-9, abs=1e-9)
            exact[axis, n] = np.allclose(given(1.05 * most), 1.05 * most)
            least = allocation.min_impulse[axis] * along
            assert given(1.001 * least) == pytest.approx(1.001 * least, rel=1e-9, abs=1e-9)
            clean[axis, n] = np.allclose(given(0.48 * least), 0.48 * least)
    # More than that is not held one way, and half of it is no clean turn one way.
    assert not exact.all(axis=1).any()
    assert not clean.all(axis=1).any()


def test_no_valve_is_open_for_longer_than_the_period():
    """Two of 60 ms share 0.11 s where each could be open for 0.1: one may not take it all."""
    allocation = ThrusterAllocation(Thrusters(min_on_time=0.06))
    rng = np.random.default_rng(5)
    for torque in rng.normal(0.0, 150.0, (200, 3)):
        assert allocation.on_times(torque, 0.1).max() <= 0.1
    assert allocation.on_times(np.array([0.0, 0.0, 90.0]), 0.01).max() <= 0.01
