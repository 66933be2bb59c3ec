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
    y, steps, dt, thrust, figures, inertia, rig,
    loop, target, gains, known_inertia, torque_max,
    matrix, offsets, quantum, remainder,
):  # fmt: skip
    """Advance the lander by one control cycle with the attitude loop on gyroscopes.

    Parameters
    ----------
    y
        True state (15,), changed in place: position, velocity, attitude, rate, mass, thrust.
    steps, dt
        Number of steps; length of a step, s.
    thrust, figures, inertia, rig
        Thrust, N; gravity, exhaust velocity, thrust lag, dry and wet mass (5,); principal moments
        of inertia with empty and full tanks (2, 3), kg m^2; other vehicle parameters (21,).
    loop, target, gains, known_inertia, torque_max
        Onboard attitude loop: its state (10,) of estimated attitude, rate and torque; commanded
        attitude (4,); natural frequency (rad/s), damping ratio and slew limit (rad/s); moments of
        inertia (3,), kg m^2; maximum torques (3,), N m.
    matrix, offsets, quantum, remainder
        Gyroscopes: scale and misalignment (3, 3), error of each step's increment (steps, 3), rad;
        resolution, rad; rounding remainder (3,), rad, changed in place.

    Returns
    -------
    history, increments, torques
        States (steps, 15), gyroscope increments (steps, 3), rad, and commanded torques (steps, 3),
        N m.
    """
    history = np.empty((steps, 15))
    increments = np.empty((steps, 3))
    torques = np.empty((steps, 3))
    work = np.empty((5, 15))
    before = np.empty(4)
    turn = np.empty(3)
    for n in range(steps):
        compute_torque(loop, target, gains, known_inertia, torque_max)
        for k in range(3):
            torques[n, k] = loop[7 + k]
        for k in range(4):
            before[k] = y[6 + k]
        advance_body(y, dt, thrust, loop[7:], figures, inertia, rig, work)
        rotation_vector_between(before, y[6:10], turn)
        quantize_increment(turn, matrix, offsets[n], quantum, remainder, increments[n])
        propagate_attitude(loop, increments[n], dt)
        for k in range(15):
            history[n, k] = y[k]
    return history, increments, torques
