# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled control cycle: vehicle, gyroscopes and attitude loop, step by step."""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import rotation_vector_between
from lunarsim._jit import kernel
from lunarsim.onboard.control._kernels import compute_torque, propagate_attitude
from lunarsim.sensors._imu_kernels import quantize_increment
from lunarsim.vehicle._kernels import advance_body


@kernel()
def fly_cycle_steps(
    state, steps, dt, thrust, params, inertia, rig,
    loop, target_attitude, gains, onboard_inertia, torque_max, torque_scale,
    matrix, offsets, quantum, remainder,
):  # fmt: skip
    """Advance the lander by one control cycle with the attitude loop on gyroscopes.

    `state` (15,), the true state, `loop` (10,), the onboard attitude, rate and torque, and
    `remainder` (3,), the rounding remainder of the gyroscopes, are changed in place. The cycle has
    `steps` steps of `dt` seconds. `thrust` is the input of the engine's lag, N. `params` (5,) is
    gravity, exhaust velocity, thrust lag, dry and full mass; `inertia` (2, 3) is the true one,
    tanks empty and full; `rig` is from `build_rig`. `target_attitude` (4,) is the command; `gains`
    (3,) is frequency, damping ratio and slew limit; `onboard_inertia` and `torque_max` are (3,).
    `torque_scale` is the true torque divided by the commanded one.
    `matrix`, `offsets` (steps, 3) and `quantum` are the gyroscope errors. Returns states (steps,
    15), gyroscope increments (steps, 3), rad, and commanded torques (steps, 3), N m.
    """
    history = np.empty((steps, 15))
    increments = np.empty((steps, 3))
    torques = np.empty((steps, 3))
    work = np.empty((5, 15))
    before = np.empty(4)
    turn = np.empty(3)
    true_torque = np.empty(3)
    for n in range(steps):
        compute_torque(loop, target_attitude, gains, onboard_inertia, torque_max)
        for k in range(3):
            torques[n, k] = loop[7 + k]
            true_torque[k] = torque_scale * loop[7 + k]
        for k in range(4):
            before[k] = state[6 + k]
        advance_body(state, dt, thrust, true_torque, params, inertia, rig, work)
        rotation_vector_between(before, state[6:10], turn)
        quantize_increment(turn, matrix, offsets[n], quantum, remainder, increments[n])
        propagate_attitude(loop, increments[n], dt)
        for k in range(15):
            history[n, k] = state[k]
    return history, increments, torques
