# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled motion of a body with slosh pendulums in its tanks.

A pendulum of mass w and length L hangs from h; its bob is at r = h + L u. All are relative to the
centre of mass of the body with liquid at rest, in body axes. The rod tension N = w (L |u'|^2 -
u . (a + alpha x r + omega x (omega x r) + 2 omega x L u')) acts on the body at h along u. The
body's mass properties include the bobs at rest; these are subtracted here. The six equations for a
and alpha form a symmetric matrix and a right-hand side, assembled tank by tank.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.models.slosh import FIRST_MODE, MIN_FILL
from lunarsim.vehicle._kernels import derivative

_MIN_FILL = MIN_FILL
_MODE = FIRST_MODE


@kernel(exact=True)
def _cross(a, b, out):
    """Write the cross product a x b of vectors (3,) into `out`."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel(exact=True)
def pendulum(tank, fill, bob):
    """Return mass, kg, and length, m, of the pendulum equivalent to a sloshing tank.

    `tank` (7,) is a row of `Slosh.table` and `fill` the remaining fraction of its liquid. The rest
    position of the bob, body axes, m, is written into `bob` (3,).
    """
    radius, depth = tank[3], fill * tank[5] / tank[3]
    steep = np.tanh(_MODE * depth)
    bob[0] = tank[0]
    bob[1] = tank[1]
    bob[2] = tank[2] + radius * (depth - 2.0 * np.tanh(0.5 * _MODE * depth) / _MODE)
    mass = fill * tank[4] * 2.0 * steep / (_MODE * (_MODE * _MODE - 1.0) * depth)
    return mass, radius / (_MODE * steep)


@kernel()
def _subtract_bob(mass, bob, rate, mass_matrix, right_side):
    """Remove a pendulum bob fixed to the body from the equations of motion.

    `_add_pendulum` then adds the swinging bob. The equations are `mass_matrix` (6, 6) times linear
    and angular acceleration = `right_side`. `mass` and `bob` (3,) are the bob's mass, kg, and
    position from the centre of mass, m; `rate` (3,) is the angular velocity, rad/s.
    """
    square = bob[0] * bob[0] + bob[1] * bob[1] + bob[2] * bob[2]
    for k in range(3):
        mass_matrix[k, k] -= mass
        mass_matrix[3 + k, 3 + k] -= mass * square
        for j in range(3):
            mass_matrix[3 + k, 3 + j] += mass * bob[k] * bob[j]
    for k in range(3):
        i = (k + 1) % 3
        j = (k + 2) % 3
        mass_matrix[i, 3 + j] -= mass * bob[k]
        mass_matrix[j, 3 + i] += mass * bob[k]
        mass_matrix[3 + j, i] -= mass * bob[k]
        mass_matrix[3 + i, j] += mass * bob[k]
    pull = np.empty(3)
    turn = np.empty(3)
    _cross(rate, bob, turn)
    _cross(rate, turn, pull)
    _cross(bob, pull, turn)
    for k in range(3):
        right_side[k] += mass * pull[k]
        right_side[3 + k] += mass * turn[k]


@kernel()
def _inertial_acceleration(rate, arm, swing, out):
    """Write the centripetal and Coriolis acceleration (3,) of a bob into `out`.

    `rate` (3,) is the angular velocity of the body, rad/s, `arm` (3,) the position of the bob, m,
    and `swing` (3,) its velocity relative to the body, m/s.
    """
    turn = np.empty(3)
    _cross(rate, arm, turn)
    for k in range(3):
        turn[k] += 2.0 * swing[k]
    _cross(rate, turn, out)


@kernel(exact=True)
def _solve(matrix, right):
    """Solve matrix @ x = right by Cholesky factorization; `right` becomes x.

    The symmetric positive definite matrix is overwritten.
    """
    n = right.shape[0]
    for j in range(n):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] * matrix[j, k]
        matrix[j, j] = np.sqrt(matrix[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    for i in range(n):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]


@kernel()
def _add_pendulum(
    t, rod_states, rate, com, fill, thrust_acceleration, tanks, mass_matrix, right_side
):
    """Replace the bob at rest of tank t by its pendulum in the equations of motion.

    `rod_states` (n, 6) are rod directions and their rates, `rate` (3,) is the angular velocity,
    `com` (3,) the centre of mass, `fill` the remaining fraction of the liquid,
    `thrust_acceleration` that of the body without gravity, m/s^2, and `tanks` (n, 7) is from
    `Slosh.table`; `mass_matrix` and `right_side` are those of `_subtract_bob`.
    """
    bob, own, swing, drag, turn = (
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
    )
    generalised = np.empty(6)
    u = rod_states[t, :3]
    m, length = pendulum(tanks[t], fill, bob)
    square = 0.0
    for k in range(3):
        bob[k] -= com[k]
        swing[k] = length * rod_states[t, 3 + k]
        square += rod_states[t, 3 + k] * rod_states[t, 3 + k]
        # Damping force of the liquid on the tank.
        drag[k] = 2.0 * tanks[t, 6] * np.sqrt(thrust_acceleration / length) * m * swing[k]
    _subtract_bob(m, bob, rate, mass_matrix, right_side)
    bob[2] += length  # the hinge
    _cross(bob, u, turn)
    for k in range(3):
        generalised[k] = u[k]
        generalised[3 + k] = turn[k]
        bob[k] += length * u[k]  # the bob at its swing angle
    _inertial_acceleration(rate, bob, swing, own)
    pull = length * square - (u[0] * own[0] + u[1] * own[1] + u[2] * own[2])
    _cross(bob, drag, turn)
    for i in range(6):
        right_side[i] += m * pull * generalised[i] + (drag[i] if i < 3 else turn[i - 3])
        for j in range(6):
            mass_matrix[i, j] += m * generalised[i] * generalised[j]


@kernel()
def _rod_motion(
    t, rod_states, rate, body_acceleration, com, fill, thrust_acceleration, tanks, rod_rates
):
    """Write the rates of change of the rod of tank t into `rod_rates[t]` (6,).

    `body_acceleration` (6,) is linear and angular acceleration; the other arguments are those of
    `_add_pendulum`.
    """
    bob, own, swing, turn = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    _, length = pendulum(tanks[t], fill, bob)
    slow = 2.0 * tanks[t, 6] * np.sqrt(thrust_acceleration / length)
    for k in range(3):
        bob[k] += length * rod_states[t, k] - com[k]
        swing[k] = length * rod_states[t, 3 + k]
    bob[2] += length
    _inertial_acceleration(rate, bob, swing, own)
    _cross(body_acceleration[3:], bob, turn)
    along, square = 0.0, 0.0
    for k in range(3):
        own[k] += body_acceleration[k] + turn[k]
        along += rod_states[t, k] * own[k]
        square += rod_states[t, 3 + k] * rod_states[t, 3 + k]
    for k in range(3):
        u = rod_states[t, k]
        rod_rates[t, k] = rod_states[t, 3 + k]
        rod_rates[t, 3 + k] = (
            (along * u - own[k]) / length - square * u - slow * rod_states[t, 3 + k]
        )


@kernel()
def _correct_accelerations(
    rod_states, out, specific_force, rate, mass, moments, com, fill, tanks, rod_rates
):
    """Correct the accelerations of a body for the motion of its sloshing liquid.

    `specific_force` is the acceleration (3,), body axes, without gravity; `out` is dy/dt (15,).
    Both are given for liquid at rest and are corrected in place. `rod_states` (n, 6) are the
    direction u of each pendulum's rod and its rate, body axes; `rod_rates` (n, 6) receives their
    derivatives. `mass`, `moments` (3,), `com` (3,) and `fill` are mass, principal moments, centre
    of mass and remaining fraction of the liquid; `tanks` (n, 7) is from `Slosh.table`.
    """
    matrix = np.zeros((6, 6))
    right = np.empty(6)
    thrust_acceleration = np.sqrt(
        specific_force[0] * specific_force[0]
        + specific_force[1] * specific_force[1]
        + specific_force[2] * specific_force[2]
    )
    for k in range(3):
        matrix[k, k] = mass
        matrix[3 + k, 3 + k] = moments[k]
        right[k] = mass * specific_force[k]
        right[3 + k] = moments[k] * out[10 + k]
    for t in range(tanks.shape[0]):
        _add_pendulum(t, rod_states, rate, com, fill, thrust_acceleration, tanks, matrix, right)
    _solve(matrix, right)
    for k in range(3):
        specific_force[k] = right[k]
        out[10 + k] = right[3 + k]
    for t in range(tanks.shape[0]):
        _rod_motion(t, rod_states, rate, right, com, fill, thrust_acceleration, tanks, rod_rates)


@kernel()
def rates(
    y, rod_states, state_rates, rod_rates, thrust_command, torque, params, inertia, rig, tanks
):
    """Write the derivatives of the state (15,) and of the slosh pendulums (n, 6).

    `y` and `rod_states` are the state and the rods (direction and rate of each); `state_rates` and
    `rod_rates` receive their derivatives. With nearly empty tanks `rod_rates` becomes 0. `tanks`
    (n, 7) is from `Slosh.table`; the other arguments are those of `advance_body`.
    """
    dry, wet = params[3], params[4]
    derivative(
        y, state_rates, thrust_command, torque, params[0], params[1], params[2], dry, wet,
        inertia[0], inertia[1], rig,
    )  # fmt: skip
    rod_rates[:] = 0.0
    fill = (y[13] + rig[16] - dry) / (wet - dry)
    if fill < _MIN_FILL:
        return
    full = (y[13] - dry) / (wet - dry)
    specific_force, moments, com, before = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        specific_force[k] = (y[14] * rig[4 + k] + rig[k]) / y[13]
        before[k] = specific_force[k]
        moments[k] = inertia[0, k] + full * (inertia[1, k] - inertia[0, k])
        com[k] = rig[10 + k] + full * (rig[13 + k] - rig[10 + k])
    _correct_accelerations(
        rod_states,
        state_rates,
        specific_force,
        y[10:13],
        y[13],
        moments,
        com,
        fill,
        tanks,
        rod_rates,
    )
    x, u, z, w = y[6], y[7], y[8], y[9]
    a, b, c = (
        specific_force[0] - before[0],
        specific_force[1] - before[1],
        specific_force[2] - before[2],
    )
    state_rates[3] += (
        (1 - 2 * (u * u + z * z)) * a + 2 * (x * u - w * z) * b + 2 * (x * z + w * u) * c
    )
    state_rates[4] += (
        2 * (x * u + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (u * z - w * x) * c
    )
    state_rates[5] += (
        2 * (x * z - w * u) * a + 2 * (u * z + w * x) * b + (1 - 2 * (x * x + u * u)) * c
    )


@kernel()
def advance(y, rod_states, dt, thrust_command, torque, params, inertia, rig, tanks):
    """Advance a state and its slosh pendulums by one Runge-Kutta step in place.

    `y` (15,) is the state and `rod_states` (n, 6) the direction and rate of each rod; `tanks`
    (n, 7) is from `Slosh.table`; the other arguments are those of `advance_body`.
    """
    dry = params[3]
    if y[13] <= dry - (1.0 - 1e-6) * rig[16]:
        thrust_command = 0.0
        y[14] = 0.0
    if params[2] == 0.0:
        y[14] = thrust_command
    n = rod_states.shape[0]
    at, swung = y.copy(), rod_states.copy()
    out, sout = np.empty(15), np.empty((n, 6))
    total, stotal = np.zeros(15), np.zeros((n, 6))
    for stage in range(4):
        rates(at, swung, out, sout, thrust_command, torque, params, inertia, rig, tanks)
        weight = 1.0 if stage % 3 == 0 else 2.0
        part = dt if stage == 2 else 0.5 * dt
        total += weight * out
        stotal += weight * sout
        at[:] = y + part * out
        swung[:] = rod_states + part * sout
    y += dt / 6.0 * total
    rod_states += dt / 6.0 * stotal
    y[6:10] /= np.sqrt(np.sum(y[6:10] ** 2))
    for t in range(n):
        rod_states[t, :3] /= np.sqrt(np.sum(rod_states[t, :3] ** 2))
        rod_states[t, 3:] -= np.sum(rod_states[t, 3:] * rod_states[t, :3]) * rod_states[t, :3]
    y[13] = max(y[13], dry - rig[16] - dt * rig[3])
