from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust, quat_angle, quat_to_matrix
from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander
from lunarsim.vehicle import Dynamics, State

G = 1.622
UP = np.array([0.0, 0.0, 0.0, 1.0])


def start(lander: Lander, **changes) -> State:
    state = State(np.zeros(3), np.zeros(3), UP, np.zeros(3), lander.wet_mass, 0.0)
    return replace(state, **changes)


def flown(
    dynamics: Dynamics, state: State, steps: int, thrust: float = 0.0, torque=(0.0, 0.0, 0.0)
) -> np.ndarray:
    """Return the state vectors (steps, 15) under a steady thrust and torque."""
    history = []
    for _ in range(steps):
        state = dynamics.advance(state, thrust, np.asarray(torque))
        history.append(state.as_vector())
    return np.array(history)


def free_rotation(lander: Lander, rate: np.ndarray, dt: float, steps: int) -> np.ndarray:
    return flown(Dynamics(lander, G, dt), start(lander, rate=rate), steps)


def test_free_fall_conserves_energy_and_follows_the_parabola():
    lander = Lander()
    dynamics = Dynamics(lander, G)
    state = start(
        lander, position=np.array([0.0, 0.0, 500.0]), velocity=np.array([30.0, 5.0, -9.0])
    )
    y = flown(dynamics, state, 2000)
    t = 0.01 * np.arange(1, 2001)
    assert np.allclose(y[:, 2], 500.0 - 9.0 * t - 0.5 * G * t**2, atol=1e-8)
    energy = 0.5 * (y[:, 3:6] ** 2).sum(axis=1) + G * y[:, 2]
    assert np.ptp(energy) < 1e-8
    assert np.all(y[:, 13] == lander.wet_mass)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_torque_free_rotation_conserves_momentum_and_energy(rate):
    lander = Lander(inertia_full=(900.0, 1400.0, 1900.0))
    y = free_rotation(lander, np.array(rate), 0.01, 2000)
    inertia = np.array(lander.inertia_full)
    momentum = np.einsum("nij,nj->ni", quat_to_matrix(y[:, 6:10]), inertia * y[:, 10:13])
    first = inertia * np.array(rate)
    assert np.allclose(momentum, first, atol=1e-6 * max(1.0, np.linalg.norm(first)))
    energy = 0.5 * (inertia * y[:, 10:13] ** 2).sum(axis=1)
    assert np.ptp(energy) <= 1e-7 * max(1.0, energy[0])
    assert np.allclose(np.linalg.norm(y[:, 6:10], axis=1), 1.0, atol=1e-12)


def test_integrator_is_of_fourth_order():
    lander = Lander(inertia_full=(900.0, 1400.0, 1900.0))
    rate = np.array([1.0, 2.0, -1.5])
    ends = [
        free_rotation(lander, rate, dt, round(1.6 / dt))[-1, 6:13] for dt in (0.1, 0.05, 0.0125)
    ]
    errors = [np.linalg.norm(end - ends[-1]) for end in ends[:2]]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.4)


def test_rocket_equation():
    lander = Lander(thrust_lag=0.0)
    dynamics = Dynamics(lander, 1e-12)
    thrust = 5000.0
    y = flown(dynamics, start(lander), 6000, thrust)
    burnt = thrust * 60.0 / lander.exhaust_velocity
    assert y[-1, 13] == pytest.approx(lander.wet_mass - burnt, rel=1e-12)
    dv = lander.exhaust_velocity * np.log(lander.wet_mass / y[-1, 13])
    assert y[-1, 5] == pytest.approx(dv, rel=1e-9)


def test_engine_lag_is_first_order():
    lander = Lander(thrust_lag=0.2)
    y = flown(Dynamics(lander, G), start(lander), 100, 4000.0)
    t = 0.01 * np.arange(1, 101)
    assert np.allclose(y[:, 14], 4000.0 * (1.0 - np.exp(-t / 0.2)), rtol=1e-6)


def test_throttle_range_and_empty_tanks():
    lander = Lander(thrust_lag=0.0, propellant_mass=5.0)
    dynamics = Dynamics(lander, G)
    assert dynamics.advance(start(lander), 10.0, np.zeros(3)).thrust == lander.thrust_min
    assert dynamics.advance(start(lander), 1e9, np.zeros(3)).thrust == lander.thrust_max
    y = flown(dynamics, start(lander), 600, 6000.0)
    assert y[-1, 13] == lander.dry_mass
    assert y[-1, 14] == 0.0


@pytest.mark.parametrize("axis", range(3))
def test_torque_turns_by_the_inertia_of_the_mass_that_is_left(axis):
    lander = Lander(inertia_full=(900.0, 1400.0, 1900.0))
    torque = 40.0 * np.eye(3)[axis]
    for mass, inertia in (
        (lander.wet_mass, lander.inertia_full),
        (lander.dry_mass, lander.inertia_dry),
        (0.5 * (lander.wet_mass + lander.dry_mass), (1000.0, 1250.0, 1600.0)),
    ):
        y = flown(Dynamics(lander, G), start(lander, mass=mass), 200, torque=torque)
        assert y[-1, 10:13] == pytest.approx(2.0 * torque / inertia[axis], rel=1e-9)
        assert quat_angle(UP, y[-1, 6:10]) == pytest.approx(80.0 / inertia[axis], rel=1e-6)


def test_thrusters_give_no_more_torque_than_they_can():
    lander = Lander(torque_max=(50.0, 40.0, 30.0))
    state = Dynamics(lander, G).advance(start(lander), 600.0, np.array([1e6, -1e6, 1e6]))
    most = np.array([50.0, -40.0, 30.0]) / lander.inertia_full
    assert state.rate == pytest.approx(0.01 * most, rel=1e-3)


def test_ideal_attitude_reaches_the_command():
    lander = Lander()
    target = attitude_from_thrust([0.4, -0.3, 1.0], 0.8)
    y = Dynamics(lander, G).advance_ideal(
        start(lander), Command(2500.0, target), np.deg2rad(15.0), 800
    )
    assert quat_angle(y[-1, 6:10], target) < 1e-3
    assert np.linalg.norm(y[-1, 10:13]) < 1e-2


def test_ideal_attitude_keeps_to_the_slew_limit():
    lander = Lander()
    limit = np.deg2rad(5.0)
    target = attitude_from_thrust([1.0, 0.0, 1.0], 0.0)
    y = Dynamics(lander, G).advance_ideal(start(lander), Command(2500.0, target), limit, 300)
    turned = quat_angle(y[1:, 6:10], y[:-1, 6:10])
    assert turned.max() <= limit * 0.01 * (1.0 + 1e-6)
    assert quat_angle(UP, y[-1, 6:10]) == pytest.approx(limit * 3.0, rel=1e-6)
    assert np.linalg.norm(y[:, 10:13], axis=1) == pytest.approx(limit, rel=1e-6)


def test_ideal_attitude_moves_as_the_body_does():
    """Held upright, the two ways to advance are one."""
    lander = Lander()
    dynamics = Dynamics(lander, G)
    ideal = dynamics.advance_ideal(start(lander), Command(4000.0, UP), 0.1, 200)
    assert np.array_equal(ideal, flown(dynamics, start(lander), 200, 4000.0))


@pytest.mark.parametrize("change", [{"gravity": 0.0}, {"step": -0.01}, {"step": np.nan}])
def test_impossible_dynamics_are_refused(change):
    with pytest.raises(InputError, match=f"dynamics.{next(iter(change))}"):
        Dynamics(**({"lander": Lander(), "gravity": G} | change))
