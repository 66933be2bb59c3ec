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
def limited_torque(error, rate, inertia, frequency, damping, slew_limit, max_torque):
    """Return the torque of the proportional-derivative law about one axis, N m.

    `error` (rad) is the commanded minus the estimated angle, `rate` (rad/s) the angular rate, and
    `slew_limit` (rad/s) the limit of the commanded rate. `frequency` (rad/s) and `damping` (ratio)
    are those of the closed loop. `inertia` is in kg m^2; `max_torque` (N m) limits the result.
    """
    # Large errors saturate the commanded rate as well as the torque.
    commanded_rate = min(max(frequency / (2.0 * damping) * error, -slew_limit), slew_limit)
    torque = inertia * 2.0 * damping * frequency * (commanded_rate - rate)
    return min(max(torque, -max_torque), max_torque)


@kernel()
def compute_torque(state, target, gains, inertia, torque_max):
    """Write the torque (3,), N m, of the proportional-derivative law to `state[7:]`.

    `state` (10,) is estimated attitude (4), rate (3) and torque (3); `target` (4,) is the commanded
    attitude. `gains` is natural frequency (rad/s), damping ratio, slew limit (rad/s). `inertia`
    (3,) is in kg m^2, `torque_max` (3,) in N m.
    """
    error = np.empty(3)
    rotation_vector_between(state[:4], target, error)
    for k in range(3):
        state[7 + k] = limited_torque(
            error[k], state[4 + k], inertia[k], gains[0], gains[1], gains[2], torque_max[k]
        )


@kernel()
def propagate_attitude(state, angle_increment, step):
    """Propagate attitude and rate in `state` by a gyroscope increment (3,), rad.

    `step` is the sample period, s.
    """
    rotate_quaternion(state[:4], angle_increment)
    for k in range(3):
        state[4 + k] = angle_increment[k] / step


@kernel()
def replay(state, target, gains, inertia, torque_max, increments, step):
    """Return the torques (n, 3), N m, of the law for recorded angle increments (n, 3).

    Each step computes the torque and then propagates the attitude in `state` by an increment, rad.
    `step` is the sample period, s; the other arguments are those of `compute_torque`.
    """
    torques = np.empty((increments.shape[0], 3))
    for n in range(increments.shape[0]):
        compute_torque(state, target, gains, inertia, torque_max)
        torques[n] = state[7:]
        propagate_attitude(state, increments[n], step)
    return torques


@kernel()
def limited_thrust_attitude(
    acceleration, mass, thrust_min, thrust_max, heading, max_tilt, attitude
):
    """Write the attitude (4,) for a thrust acceleration (3,); return the thrust, N.

    The acceleration is in ENU, m/s^2, `mass` in kg, and `heading` is the azimuth of body x, rad.
    The tilt is limited to `max_tilt` (rad), the thrust to `thrust_min` and `thrust_max` (N). If the
    thrust does not suffice, the vertical component has priority. `attitude` receives the
    quaternion.
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
