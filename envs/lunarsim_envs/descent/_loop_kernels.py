# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled attitude loop for blocks of landers, with perfect gyroscopes.

A block has one column per lander: `states` (15, width) has position, velocity, attitude, body rate,
mass and thrust; `loop_state` (ROWS, width) has the rows that are listed below.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.control._kernels import limited_torque

# Rows of `loop_state` (ROWS, width): commanded and previous attitude; measured body rate; commanded
# torques; moments of inertia; commanded thrust; flight time; randomized parameters
# (`domain_randomization.RANDOM_QUANTITIES`); height below which the lander may touch down.
AIM, BEFORE, RATE, TORQUE, MOMENT, THRUST, TIME, FAILS, ENGINE, WEAK, SHARE, OFFSET, FLOOR = (
    0, 4, 8, 11, 14, 17, 18, 19, 20, 21, 24, 25, 27,
)  # fmt: skip
ROWS = 28
# Polynomials of Cephes' atan (Moshier, 1989) in the squared tangent; relative error 2e-16.
_P = (
    -8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1,
    -1.228866684490136173410e2, -6.485021904942025371773e1,
)  # fmt: skip
_Q = (
    2.485846490142306297962e1, 1.650270098316988542046e2, 4.328810604912902668951e2,
    4.853903996359136964868e2, 1.945506571482613964425e2,
)  # fmt: skip
# Tangents of 3/8 pi, and of the limit above which pi / 4 is subtracted.
_STEEP, _MIDDLE = 2.41421356237309504880, 0.66


@kernel(exact=True)
def first_quadrant_angle(s, w):
    """Return the angle atan2(s, w), rad, for s and w of 0 or more, without branches."""
    steep = s > _STEEP * w
    middle = s > _MIDDLE * w
    over = -w if steep else (s - w if middle else s)
    under = s if steep else (s + w if middle else w)
    start = 0.5 * np.pi if steep else (0.25 * np.pi if middle else 0.0)
    x = over / max(under, 1e-300)
    z = x * x
    p = (((_P[0] * z + _P[1]) * z + _P[2]) * z + _P[3]) * z + _P[4]
    q = ((((z + _Q[0]) * z + _Q[1]) * z + _Q[2]) * z + _Q[3]) * z + _Q[4]
    return start + (x + x * z * p / q)


@kernel(exact=True)
def _rotation_between(from_rows, from_row, to_rows, to_row, out, n):
    """Compute the rotation vector between two attitudes of the lander in column n.

    The first quaternion is in the rows of `from_rows` that start at `from_row`, the second likewise
    in `to_rows`. Writes the vector, rad, in axes of the first attitude, to column n of `out` (3,
    width).
    """
    qx, qy, qz, qw = (
        from_rows[from_row, n],
        from_rows[from_row + 1, n],
        from_rows[from_row + 2, n],
        from_rows[from_row + 3, n],
    )
    tx, ty, tz, tw = (
        to_rows[to_row, n],
        to_rows[to_row + 1, n],
        to_rows[to_row + 2, n],
        to_rows[to_row + 3, n],
    )
    x = qw * tx - qx * tw - qy * tz + qz * ty
    y = qw * ty - qy * tw - qz * tx + qx * tz
    z = qw * tz - qz * tw - qx * ty + qy * tx
    w = qw * tw + qx * tx + qy * ty + qz * tz
    s = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 * first_quadrant_angle(s, abs(w)) / s if s > 1e-12 else 2.0
    scale = -scale if w < 0.0 else scale
    out[0, n] = scale * x
    out[1, n] = scale * y
    out[2, n] = scale * z


@kernel(inner=True)
def command_torques(states, loop_state, width, gains, max_torque, error):
    """Compute control torques of a block of landers by a proportional-derivative law.

    Writes the torques to `loop_state`, with the attitude, from which `measure_rates` computes the
    next rates. `gains` (3,) are those of the attitude loop, `max_torque` (3,) is in N m, and
    `error` (3, width) is scratch.
    """
    for n in range(width):
        _rotation_between(states, 6, loop_state, AIM, error, n)
    for k in range(3):
        for n in range(width):
            loop_state[TORQUE + k, n] = limited_torque(
                error[k, n], loop_state[RATE + k, n], loop_state[MOMENT + k, n], gains[0],
                gains[1], gains[2], max_torque[k],
            )  # fmt: skip
    for k in range(4):
        for n in range(width):
            loop_state[BEFORE + k, n] = states[6 + k, n]


@kernel(inner=True)
def measure_rates(states, loop_state, width, dt, turn):
    """Compute the gyroscope rates from the change of attitude over the last step.

    Writes the rates to `loop_state`. `dt` is the step, s, and `turn` (3, width) is scratch.
    """
    for n in range(width):
        _rotation_between(loop_state, BEFORE, states, 6, turn, n)
    for k in range(3):
        for n in range(width):
            loop_state[RATE + k, n] = turn[k, n] / dt


@kernel(inner=True)
def actuate(states, loop_state, width, torque_scale, thrust, torque):
    """Compute the thrust and torque that the actuators deliver, with random failures.

    Writes the thrust that the engine follows to `thrust` (width,), N, and torques to `torque` (3,
    width), N m. Torques include the effect of the offset of the thrust line. `torque_scale` is the
    true torque divided by the commanded one.
    """
    for n in range(width):
        command = loop_state[THRUST, n] * (1.0 + loop_state[SHARE, n])
        thrust[n] = (
            command * loop_state[ENGINE, n]
            if loop_state[TIME, n] >= loop_state[FAILS, n]
            else command
        )
    for k in range(3):
        for n in range(width):
            command = torque_scale * loop_state[TORQUE + k, n]
            weak = command * loop_state[WEAK + k, n]
            torque[k, n] = weak if loop_state[TIME, n] >= loop_state[FAILS, n] else command
    for n in range(width):
        torque[0, n] += loop_state[OFFSET + 1, n] * states[14, n]
        torque[1, n] -= loop_state[OFFSET, n] * states[14, n]


@kernel(inner=True)
def count_low(states, loop_state, width):
    """Return the number of landers in a block low enough to touch the terrain."""
    count = 0
    for n in range(width):
        count += 1 if states[2, n] <= loop_state[FLOOR, n] else 0
    return count
