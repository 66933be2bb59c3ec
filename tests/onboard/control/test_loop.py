"""The attitude loop on gyroscopes: with a vehicle, compiled and not, flown and replayed."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import (
    attitude_from_thrust,
    quat_angle,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_to_rotation_vector,
)
from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander
from lunarsim.onboard.control.attitude import ProportionalDerivative
from lunarsim.onboard.control.loop import AttitudeLoop
from lunarsim.vehicle import Dynamics, State

STEP = 0.01
LANDER = Lander()
UP = np.array([0.0, 0.0, 0.0, 1.0])


class InPython(ProportionalDerivative):
    """The same law, which the compiled loop does not know."""


LAWS = (ProportionalDerivative, InPython)


def begun(law, target, lander=LANDER, attitude=UP) -> AttitudeLoop:
    loop = AttitudeLoop(law, lander, STEP)
    loop.start_cycle(Command(2500.0, target), attitude, lander.wet_mass)
    return loop


def held(loop: AttitudeLoop, steps: int, lander=LANDER) -> tuple[list[State], np.ndarray]:
    """Return the states (steps + 1) of a lander on perfect gyroscopes, and the torques."""
    dynamics = Dynamics(lander, 1.622, STEP)
    state = State(np.zeros(3), np.zeros(3), UP, np.zeros(3), lander.wet_mass, 2500.0)
    states, torques = [state], np.empty((steps, 3))
    for n in range(steps):
        torques[n] = loop.torque()
        state = dynamics.advance(state, 2500.0, torques[n])
        loop.propagate(
            quat_to_rotation_vector(
                quat_multiply(quat_conjugate(states[-1].attitude), state.attitude)
            )
        )
        states.append(state)
    return states, torques


@pytest.mark.parametrize("law", LAWS)
def test_attitude_reaches_the_command(law):
    target = attitude_from_thrust([0.4, -0.3, 1.0], 0.8)
    loop = begun(law(), target)
    last = held(loop, 800)[0][-1]
    assert quat_angle(last.attitude, target) < 1e-3
    assert np.linalg.norm(last.rate) < 1e-2
    # What it believes is where the gyroscopes have taken it.
    assert quat_angle(loop.state[:4], last.attitude) < 1e-9


def test_a_small_step_is_answered_as_by_a_second_order_lag():
    """Peak and time of the peak of the continuous loop, sampled every 10 ms."""
    law = ProportionalDerivative(frequency=2.0, damping=0.5)
    states, _ = held(begun(law, quat_from_rotation_vector([0.02, 0.0, 0.0])), 400)
    angle = np.array([2.0 * s.attitude[0] for s in states])
    root = np.sqrt(1.0 - 0.5**2)
    assert angle.max() / 0.02 == pytest.approx(1.0 + np.exp(-np.pi * 0.5 / root), abs=0.01)
    assert STEP * np.argmax(angle) == pytest.approx(np.pi / (2.0 * root), abs=0.05)


@pytest.mark.parametrize("law", LAWS)
def test_torques_stay_within_the_thrusters(law):
    lander = Lander(torque_max=(50.0, 40.0, 30.0))
    loop = begun(law(slew_limit=5.0), attitude_from_thrust([1.0, -0.5, 0.2], 2.0), lander)
    states, torques = held(loop, 50, lander)
    assert (np.abs(torques) <= lander.torque_max).all()
    assert (np.abs(torques).max(axis=0) == lander.torque_max).all()
    rates = np.array([s.rate for s in states])
    acceleration = np.abs(np.diff(rates, axis=0)) / STEP
    assert acceleration.max() <= 50.0 / min(lander.inertia_dry) * 1.01


def test_turns_keep_to_the_slew_limit():
    limit = np.deg2rad(5.0)
    loop = begun(ProportionalDerivative(slew_limit=limit), quat_from_rotation_vector([1.2, 0, 0]))
    states, _ = held(loop, 600)
    rates = np.array([s.rate for s in states])
    assert np.abs(rates).max() < 1.02 * limit
    assert rates[300:, 0] == pytest.approx(limit, rel=0.01)


def test_compiled_or_in_python_is_the_same_law():
    target = attitude_from_thrust([0.4, -0.3, 1.0], 0.8)
    loops = [begun(law(), target) for law in LAWS]
    assert [loop.compiled for loop in loops] == [True, False]
    (_, ours), (_, plain) = (held(loop, 300) for loop in loops)
    assert ours == pytest.approx(plain, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_replay_gives_the_torques_as_flown(law):
    """Bit for bit, over several commands and gyroscopes that err."""
    rng = np.random.default_rng(2)
    flown, replayed = (AttitudeLoop(law(), LANDER, STEP) for _ in range(2))
    for _ in range(5):
        command = Command(2500.0, attitude_from_thrust([*rng.normal(0.0, 0.3, 2), 1.0], 0.4))
        attitude, mass = quat_from_rotation_vector(0.1 * rng.standard_normal(3)), 1400.0
        for loop in (flown, replayed):
            loop.start_cycle(command, attitude, mass)
        increments = 1e-3 * rng.standard_normal((10, 3))
        torques = np.empty((10, 3))
        for n in range(10):
            torques[n] = flown.torque()
            flown.propagate(increments[n])
        assert replayed.replay(increments).tobytes() == torques.tobytes()
        assert replayed.state.tobytes() == flown.state.tobytes()


def test_inertia_is_that_of_the_mass_it_is_given():
    target = quat_from_rotation_vector([1e-3, 2e-3, -1e-3])
    torques = []
    for mass in (LANDER.wet_mass, LANDER.dry_mass):
        loop = AttitudeLoop(ProportionalDerivative(), LANDER, STEP)
        loop.start_cycle(Command(2500.0, target), UP, mass)
        torques.append(loop.torque())
    ratio = np.array(LANDER.inertia_full) / LANDER.inertia_dry
    assert torques[0] / torques[1] == pytest.approx(ratio)


@pytest.mark.parametrize("law", LAWS)
def test_a_command_begins_from_the_attitude_of_navigation(law):
    """Wherever the gyroscopes had taken it: told to be where it shall be, it asks for nothing."""
    target = attitude_from_thrust([0.4, -0.3, 1.0], 0.8)
    loop = begun(law(), target)
    assert np.abs(loop.torque()).max() > 1.0
    loop.start_cycle(Command(2500.0, target), target, LANDER.wet_mass)
    assert loop.torque() == pytest.approx(np.zeros(3), abs=1e-9)
