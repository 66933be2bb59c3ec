"""One control cycle: vehicle, gyroscopes and attitude loop together."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import (
    attitude_from_thrust,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_to_rotation_vector,
)
from lunarsim.messages.commands import Command
from lunarsim.messages.measurements import InertialSamples
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.models.lander import Lander
from lunarsim.onboard.control.attitude import IdealAttitude, ProportionalDerivative
from lunarsim.onboard.control.loop import AttitudeLoop
from lunarsim.sensors.imu import ImuSettings
from lunarsim.simulation.cycle import fly_cycle
from lunarsim.simulation.plant import Plant
from lunarsim.vehicle import Dynamics, State
from lunarsim.world import World
from tests.worlds import flat_terrain

G, STEP, STEPS = 1.622, 0.01, 10
LANDER = Lander()
START = quat_from_rotation_vector([0.1, -0.05, 0.3])


class InPython(ProportionalDerivative):
    """The same law, which the compiled cycle does not know."""


class Doubled(ProportionalDerivative):
    """Another law."""

    def torque(self, error, rate, inertia):
        return 2.0 * super().torque(error, rate, inertia)


def plant(unit=ImuSettings(), height=300.0, speed=-12.0) -> Plant:  # noqa: B008
    state = State(
        np.array([0.0, 0.0, height]), np.array([8.0, -3.0, speed]), START,
        np.array([0.01, -0.02, 0.03]), LANDER.wet_mass, 2600.0,
    )  # fmt: skip
    sensors = {} if unit is None else {"imu": (unit, np.random.default_rng(3))}
    world = World(flat_terrain(400.0, 4.0), G)
    return Plant(world, Dynamics(LANDER, G, STEP), state, sensors, steps=STEPS, max_time=100.0)


def commands(count: int):
    rng = np.random.default_rng(5)
    for _ in range(count):
        pull = [*rng.normal(0.0, 0.3, 2), 1.0]
        yield Command(float(rng.uniform(2000.0, 4000.0)), attitude_from_thrust(pull, 0.3))


def fly(law, count=8, **made):
    """Return the plant after some cycles, its loop, and all measurements and torques."""
    moving, loop = plant(**made), AttitudeLoop(law, LANDER, STEP)
    measured, torques = [], []
    for command in commands(count):
        # Navigation errs: the loop starts each cycle from an attitude a little off.
        attitude = quat_multiply(moving.state.attitude, quat_from_rotation_vector([0.0, 2e-3, 0.0]))
        loop.start_cycle(command, attitude, moving.state.mass)
        cycle = fly_cycle(moving, loop, command)
        measured.append(cycle.measurements)
        torques.append(cycle.torques)
    return moving, loop, measured, torques


def angles(measurements) -> np.ndarray:
    ((name, samples),) = measurements.items
    assert name == "imu"
    assert isinstance(samples, InertialSamples)
    return samples.angle


def test_the_compiled_cycle_is_the_one_stepped_in_python():
    ours, plain = fly(ProportionalDerivative()), fly(InPython())
    assert [run[1].compiled for run in (ours, plain)] == [True, False]
    assert ours[0].state.as_vector() == pytest.approx(plain[0].state.as_vector(), rel=1e-12)
    assert ours[1].state == pytest.approx(plain[1].state, rel=1e-12, abs=1e-12)
    for a, b in zip(ours[3], plain[3], strict=True):
        assert a == pytest.approx(b, rel=1e-12, abs=1e-9)
    for a, b in zip(ours[2], plain[2], strict=True):
        assert angles(a) == pytest.approx(angles(b), rel=1e-12, abs=1e-15)


def test_a_law_of_ones_own_is_flown():
    own, plain = fly(Doubled()), fly(InPython())
    assert np.abs(own[3][0][0]) == pytest.approx(
        np.minimum(2.0 * np.abs(plain[3][0][0]), LANDER.torque_max)
    )
    assert not np.allclose(own[0].state.attitude, plain[0].state.attitude, atol=1e-3)


@pytest.mark.parametrize(
    "law", [ProportionalDerivative(), InPython()], ids=lambda v: type(v).__name__
)
def test_recorded_increments_give_the_torques_again(law):
    """What the plant sends is all that the loop has seen: bit for bit."""
    moving, loop = plant(), AttitudeLoop(law, LANDER, STEP)
    again = AttitudeLoop(law, LANDER, STEP)
    for command in commands(6):
        attitude, mass = moving.state.attitude, moving.state.mass
        for one in (loop, again):
            one.start_cycle(command, attitude, mass)
        cycle = fly_cycle(moving, loop, command)
        torques = again.replay(angles(cycle.measurements))
        assert torques.shape == (STEPS, 3)
        assert torques.tobytes() == cycle.torques.tobytes()
        assert again.state.tobytes() == loop.state.tobytes()


def test_perfect_gyroscopes_give_the_turn_of_the_vehicle():
    perfect = ImuSettings(TriadErrors(), TriadErrors())
    moving = plant(unit=perfect)
    loop = AttitudeLoop(ProportionalDerivative(), LANDER, STEP)
    for command in commands(5):
        before = moving.state.attitude
        loop.start_cycle(command, before, moving.state.mass)
        measured = fly_cycle(moving, loop, command).measurements
        turned = before
        for increment in angles(measured):
            turned = quat_multiply(turned, quat_from_rotation_vector(increment))
        left = quat_multiply(quat_conjugate(turned), moving.state.attitude)
        assert np.linalg.norm(quat_to_rotation_vector(left)) < 1e-12
        assert abs(loop.state[:4] @ moving.state.attitude) == pytest.approx(1.0, abs=1e-12)
        assert measured.time == pytest.approx(moving.time)


def test_an_ideal_actuator_needs_no_gyroscopes():
    law = IdealAttitude(slew_limit=0.1)
    moving, _, measured, torques = fly(law, unit=None)
    assert all(t.shape == (0, 3) for t in torques)
    assert all(m.items == () for m in measured)
    expected = plant(unit=None)
    for command in commands(8):
        history = expected.dynamics.advance_ideal(expected.state, command, 0.1, STEPS)
        expected.adopt_motion(history, {})
    assert moving.state.as_vector().tobytes() == expected.state.as_vector().tobytes()
    # With an inertial unit on board its gyroscopes are sampled all the same.
    _, _, measured, _ = fly(law)
    assert all(angles(m).shape == (STEPS, 3) for m in measured)


def test_a_touchdown_ends_the_cycle_and_its_samples():
    moving = plant(height=LANDER.com_height + 1.3, speed=-20.0)
    loop = AttitudeLoop(ProportionalDerivative(), LANDER, STEP)
    command = Command(600.0, START)
    loop.start_cycle(command, START, LANDER.wet_mass)
    cycle = fly_cycle(moving, loop, command)
    assert moving.outcome is not None
    steps = round(moving.time / STEP)
    assert 0 < steps < STEPS
    assert len(angles(cycle.measurements)) == steps
    assert cycle.measurements.time == moving.time
