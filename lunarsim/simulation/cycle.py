"""Control cycle: vehicle, gyroscopes and attitude loop together, step by step.

The attitude loop runs on the onboard computer at the rate of the gyroscopes. A control law that the
compiled cycle supports runs there; any other law runs the same steps in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lunarsim._frame_kernels import rotation_vector_between
from lunarsim.messages.commands import Command
from lunarsim.messages.measurements import Measurements
from lunarsim.onboard.control.jets import JetLoop
from lunarsim.onboard.control.loop import AttitudeLoop
from lunarsim.sensors._imu_kernels import quantize_increment
from lunarsim.sensors.imu import Imu
from lunarsim.simulation import _cycle_kernels as k
from lunarsim.simulation.plant import Plant
from lunarsim.typing import Array
from lunarsim.vehicle.state import State


@dataclass(frozen=True)
class ControlCycleResult:
    """Measurements and commanded torques of one simulated control cycle.

    Attributes
    ----------
    measurements
        Measurements of the plant at the end of the cycle.
    torques
        Commanded torque of the attitude loop at each integration step (n, 3), N m; empty with
        ideal attitude control.
    """

    measurements: Measurements
    torques: Array


def fly_cycle(
    plant: Plant, loop: AttitudeLoop, command: Command,
    changes: Sequence[tuple[int, Command]] = (),
) -> ControlCycleResult:  # fmt: skip
    """Simulate one control cycle of vehicle and attitude loop under a command.

    `changes` are commands that replace it, each after a number of integration steps. The
    measurement tasks at the end of the cycle are those of the last command.
    """
    starts = [(0, command), *changes]
    ends = [start for start, _ in changes] + [plant.steps]
    flown: list[tuple[Array, Array, Array]] = []
    state = plant.state
    # Errors of the gyroscopes, drawn once per cycle so that they do not depend on the changes.
    gyros = next(iter(plant.imus.values())).gyroscopes if loop.law.torques else None
    offsets = np.zeros((0, 3)) if gyros is None else gyros.offsets(plant.steps)
    for (start, given), end in zip(starts, ends, strict=True):
        active = plant.apply_throttle_faults(given)
        if start > 0:
            state = State.from_vector(flown[-1][0][-1])
            loop.set_command(active)
        flown.append(_fly(plant, loop, state, active, end - start, offsets[start:end]))
    history, increments, torques = (
        flown[0] if len(flown) == 1 else map(np.concatenate, zip(*flown, strict=True))
    )
    gyroscopes = {next(iter(plant.imus)): increments} if loop.law.torques else {}
    last = starts[-1][1]
    measurements = plant.adopt_motion(history, gyroscopes, last.tasks, abort=last.abort)
    return ControlCycleResult(measurements, torques)


def _fly(
    plant: Plant, loop: AttitudeLoop, state: State, command: Command, steps: int, offsets: Array
) -> tuple[Array, Array, Array]:
    """Simulate a number of integration steps from a state under a command.

    `offsets` (n, 3) are the errors of the gyroscopes, rad.

    Return states (n, 15), gyroscope increments (n, 3), rad, and torques (n, 3), N m; the last two
    are empty with ideal attitude control.
    """
    if not loop.law.torques:
        slew = loop.law.slew_limit  # type: ignore[attr-defined]
        history = plant.dynamics.advance_ideal(state, command, slew, steps)
        return history, np.zeros((0, 3)), np.zeros((0, 3))
    imu = next(iter(plant.imus.values()))
    fly = (
        _fly_with_actuators
        if plant.actuators
        else _fly_compiled
        if loop.compiled
        else _fly_in_python
    )
    return fly(plant, loop, imu, state, command.thrust, offsets)


def _fly_compiled(
    plant: Plant, loop: AttitudeLoop, imu: Imu, state: State, thrust: float, offsets: Array
) -> tuple[Array, Array, Array]:
    """Simulate integration steps of a lander without thrusters in a compiled function.

    The results are those of `_fly_stepwise`.
    """
    d, gyros = plant.dynamics, imu.gyroscopes
    history, increments, torques = k.fly_cycle_steps(
        state.as_vector(), len(offsets), d.step, d.thrust(thrust), d.params, d.inertia,
        d.plain_rig, loop.state, loop.target, loop.gains, loop.inertia, loop.torque_max,
        d.lander.torque_scale, gyros.matrix, offsets, gyros.errors.quantum, gyros.remainder,
    )  # fmt: skip
    return history, increments, torques


def _fly_with_actuators(
    plant: Plant, loop: AttitudeLoop, imu: Imu, state: State, thrust: float, offsets: Array
) -> tuple[Array, Array, Array]:
    """Simulate integration steps of a lander with thrusters, gimbal and throttle.

    Return states (n, 15), gyroscope increments (n, 3), rad, and commanded torques (n, 3), N m,
    after each integration step.
    """
    actuators = plant.actuators
    if actuators is None or not isinstance(loop, JetLoop):
        raise TypeError("the attitude loop of a lander with thrusters must be a JetLoop")
    throttle = actuators.set_throttle(thrust)

    def advance(state: State) -> tuple[State, Array]:
        due = loop.is_due
        torque = loop.torque()
        if due:
            actuators.command(loop.on_times, loop.gimbal)
        return actuators.advance(plant.dynamics, state, throttle), torque

    return _fly_stepwise(loop, imu, state, offsets, advance)


def _fly_in_python(
    plant: Plant, loop: AttitudeLoop, imu: Imu, state: State, thrust: float, offsets: Array
) -> tuple[Array, Array, Array]:
    """Simulate integration steps of a lander without thrusters in Python.

    The results are those of `_fly_stepwise`.
    """

    def advance(state: State) -> tuple[State, Array]:
        torque = loop.torque()
        return plant.dynamics.advance(state, thrust, torque), torque

    return _fly_stepwise(loop, imu, state, offsets, advance)


def _fly_stepwise(
    loop: AttitudeLoop,
    imu: Imu,
    state: State,
    offsets: Array,
    advance: Callable[[State], tuple[State, Array]],
) -> tuple[Array, Array, Array]:
    """Simulate a number of integration steps in Python.

    `advance` returns the state after a step and the torque that the attitude loop commands. Return
    states (n, 15), gyroscope increments (n, 3), rad, and torques (n, 3), N m.
    """
    gyros = imu.gyroscopes
    steps = len(offsets)
    history = np.empty((steps, 15))
    increments = np.empty((steps, 3))
    torques = np.empty((steps, 3))
    turn = np.empty(3)
    for n in range(steps):
        before = state.attitude
        state, torques[n] = advance(state)
        rotation_vector_between(before, state.attitude, turn)
        quantize_increment(
            turn, gyros.matrix, offsets[n], gyros.errors.quantum, gyros.remainder, increments[n]
        )
        loop.propagate(increments[n])
        history[n] = state.as_vector()
    return history, increments, torques
