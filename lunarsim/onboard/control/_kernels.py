# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled attitude control with gyroscopes.

The state of the loop is (10,): estimated attitude (quaternion, scalar last), rate (3), torque (3).
"""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import (
    rotate_quaternion,
    rotation_vector_between,
    write_thrust_attitude,
)
from lunarsim._jit import kernel


@kernel(exact=True)
def limited_torque(error, rate, inertia, frequency, damping, slew, max_torque):
    """Return the torque of the proportional-derivative law about an axis, N m."""
    # Large errors saturate the commanded rate as well as the torque.
    wanted = min(max(frequency / (2.0 * damping) * error, -slew), slew)
    torque = inertia * 2.0 * damping * frequency * (wanted - rate)
    return min(max(torque, -max_torque), max_torque)


@kernel()
def compute_torque(state, target, gains, inertia, torque_max):
    """Write the torque of the proportional-derivative law into `state`.

    `gains` is natural frequency (rad/s), damping ratio, slew limit (rad/s).
    """
    error = np.empty(3)
    rotation_vector_between(state[:4], target, error)
    for k in range(3):
        state[7 + k] = limited_torque(
            error[k], state[4 + k], inertia[k], gains[0], gains[1], gains[2], torque_max[k]
        )


@kernel()
def propagate_attitude(state, increment, step):
    """Propagate the attitude by the gyroscope increment (3,) of one step."""
    rotate_quaternion(state[:4], increment)
    for k in range(3):
        state[4 + k] = increment[k] / step


@kernel()
def replay(state, target, gains, inertia, torque_max, increments, step):
    """Return the torques (n, 3) of the law for recorded increments (n, 3)."""
    torques = np.empty((increments.shape[0], 3))
    for n in range(increments.shape[0]):
        compute_torque(state, target, gains, inertia, torque_max)
        torques[n] = state[7:]
        propagate_attitude(state, increments[n], step)
    return torques


@kernel()
def thrust_attitude(acceleration, mass, thrust_min, thrust_max, heading, max_tilt, attitude):
    """Write the attitude (4,) for a thrust acceleration (3,); return the thrust, N.

    The limits are those of `thrust.thrust_to_command`.
    """
    max_torque = thrust_max / mass
    up = min(max(acceleration[2], 1e-3), max_torque)
    east, north = acceleration[0], acceleration[1]
    size = np.hypot(east, north)
    limit = min(np.sqrt(max(max_torque * max_torque - up * up, 0.0)), up * np.tan(max_tilt))
    if size > limit:
        east *= limit / size
        north *= limit / size
    write_thrust_attitude(east, north, up, heading, attitude)
    thrust = np.sqrt(east * east + north * north + up * up) * mass
    return min(max(thrust, thrust_min), thrust_max)
