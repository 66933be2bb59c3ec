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
    """Write a x b."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel(exact=True)
def pendulum(tank, fill, bob):
    """Return mass, kg, and length, m, and write the bob's rest position (3,)."""
    radius, depth = tank[3], fill * tank[5] / tank[3]
    steep = np.tanh(_MODE * depth)
    bob[0] = tank[0]
    bob[1] = tank[1]
    bob[2] = tank[2] + radius * (depth - 2.0 * np.tanh(0.5 * _MODE * depth) / _MODE)
    mass = fill * tank[4] * 2.0 * steep / (_MODE * (_MODE * _MODE - 1.0) * depth)
    return mass, radius / (_MODE * steep)


@kernel()
def _take_out(mass, bob, rate, matrix, right):
    """Subtract a bob at rest from the body's matrix (6, 6) and right-hand side (6,)."""
    square = bob[0] * bob[0] + bob[1] * bob[1] + bob[2] * bob[2]
    for k in range(3):
        matrix[k, k] -= mass
        matrix[3 + k, 3 + k] -= mass * square
        for j in range(3):
            matrix[3 + k, 3 + j] += mass * bob[k] * bob[j]
    for k in range(3):
        i = (k + 1) % 3
        j = (k + 2) % 3
        matrix[i, 3 + j] -= mass * bob[k]
        matrix[j, 3 + i] += mass * bob[k]
        matrix[3 + j, i] -= mass * bob[k]
        matrix[3 + i, j] += mass * bob[k]
    pull = np.empty(3)
    turn = np.empty(3)
    _cross(rate, bob, turn)
    _cross(rate, turn, pull)
    _cross(bob, pull, turn)
    for k in range(3):
        right[k] += mass * pull[k]
        right[3 + k] += mass * turn[k]


@kernel()
def _own(rate, arm, swing, out):
    """Write the centripetal and Coriolis acceleration of a bob at `arm` (3,)."""
    turn = np.empty(3)
    _cross(rate, arm, turn)
    for k in range(3):
        turn[k] += 2.0 * swing[k]
    _cross(rate, turn, out)


@kernel(exact=True)
def _solve(matrix, right):
    """Solve a symmetric positive definite system in place, by its Cholesky factor."""
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
def _hang(t, s, rate, com, fill, push, tanks, matrix, right):
    """Add the pendulum of tank t to the equations, in place of its bob at rest."""
    bob, own, swing, drag, turn = (
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
    )
    one = np.empty(6)
    u = s[t, :3]
    m, length = pendulum(tanks[t], fill, bob)
    square = 0.0
    for k in range(3):
        bob[k] -= com[k]
        swing[k] = length * s[t, 3 + k]
        square += s[t, 3 + k] * s[t, 3 + k]
        # Damping force of the liquid on the tank.
        drag[k] = 2.0 * tanks[t, 6] * np.sqrt(push / length) * m * swing[k]
    _take_out(m, bob, rate, matrix, right)
    bob[2] += length  # the hinge
    _cross(bob, u, turn)
    for k in range(3):
        one[k] = u[k]
        one[3 + k] = turn[k]
        bob[k] += length * u[k]  # the bob at its swing angle
    _own(rate, bob, swing, own)
    pull = length * square - (u[0] * own[0] + u[1] * own[1] + u[2] * own[2])
    _cross(bob, drag, turn)
    for i in range(6):
        right[i] += m * pull * one[i] + (drag[i] if i < 3 else turn[i - 3])
        for j in range(6):
            matrix[i, j] += m * one[i] * one[j]


@kernel()
def _swing(t, s, rate, moved, com, fill, push, tanks, sout):
    """Write the rod motion of tank t for the body's acceleration (6,)."""
    bob, own, swing, turn = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    _, length = pendulum(tanks[t], fill, bob)
    slow = 2.0 * tanks[t, 6] * np.sqrt(push / length)
    for k in range(3):
        bob[k] += length * s[t, k] - com[k]
        swing[k] = length * s[t, 3 + k]
    bob[2] += length
    _own(rate, bob, swing, own)
    _cross(moved[3:], bob, turn)
    along, square = 0.0, 0.0
    for k in range(3):
        own[k] += moved[k] + turn[k]
        along += s[t, k] * own[k]
        square += s[t, 3 + k] * s[t, 3 + k]
    for k in range(3):
        u = s[t, k]
        sout[t, k] = s[t, 3 + k]
        sout[t, 3 + k] = (along * u - own[k]) / length - square * u - slow * s[t, 3 + k]


@kernel()
def _couple(s, out, felt, rate, mass, moments, com, fill, tanks, sout):
    """Correct accelerations of a body with liquid at rest; write swing rates.

    `felt` is the acceleration (3,), body axes, without gravity; `out` is dy/dt (15,). Both are
    given for liquid at rest and are corrected in place. `s` and `sout` (n, 6): direction u of each
    rod and its rate, body axes.
    """
    matrix = np.zeros((6, 6))
    right = np.empty(6)
    push = np.sqrt(felt[0] * felt[0] + felt[1] * felt[1] + felt[2] * felt[2])
    for k in range(3):
        matrix[k, k] = mass
        matrix[3 + k, 3 + k] = moments[k]
        right[k] = mass * felt[k]
        right[3 + k] = moments[k] * out[10 + k]
    for t in range(tanks.shape[0]):
        _hang(t, s, rate, com, fill, push, tanks, matrix, right)
    _solve(matrix, right)
    for k in range(3):
        felt[k] = right[k]
        out[10 + k] = right[3 + k]
    for t in range(tanks.shape[0]):
        _swing(t, s, rate, right, com, fill, push, tanks, sout)


@kernel()
def rates(y, s, out, sout, asked, torque, figures, inertia, rig, tanks):
    """Write the rates of change of the state (15,) and of the swings (n, 6)."""
    dry, wet = figures[3], figures[4]
    derivative(
        y, out, asked, torque, figures[0], figures[1], figures[2], dry, wet, inertia[0],
        inertia[1], rig,
    )  # fmt: skip
    sout[:] = 0.0
    fill = (y[13] + rig[16] - dry) / (wet - dry)
    if fill < _MIN_FILL:
        return
    full = (y[13] - dry) / (wet - dry)
    felt, moments, com, before = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        felt[k] = (y[14] * rig[4 + k] + rig[k]) / y[13]
        before[k] = felt[k]
        moments[k] = inertia[0, k] + full * (inertia[1, k] - inertia[0, k])
        com[k] = rig[10 + k] + full * (rig[13 + k] - rig[10 + k])
    _couple(s, out, felt, y[10:13], y[13], moments, com, fill, tanks, sout)
    x, u, z, w = y[6], y[7], y[8], y[9]
    a, b, c = felt[0] - before[0], felt[1] - before[1], felt[2] - before[2]
    out[3] += (1 - 2 * (u * u + z * z)) * a + 2 * (x * u - w * z) * b + 2 * (x * z + w * u) * c
    out[4] += 2 * (x * u + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (u * z - w * x) * c
    out[5] += 2 * (x * z - w * u) * a + 2 * (u * z + w * x) * b + (1 - 2 * (x * x + u * u)) * c


@kernel()
def advance(y, s, dt, asked, torque, figures, inertia, rig, tanks):
    """Advance the state (15,) and the swings (n, 6) by one Runge-Kutta step in place.

    The arguments are those of `advance_body`; `tanks` is from `Slosh.table`.
    """
    dry = figures[3]
    if y[13] <= dry - (1.0 - 1e-6) * rig[16]:
        asked = 0.0
        y[14] = 0.0
    if figures[2] == 0.0:
        y[14] = asked
    n = s.shape[0]
    at, swung = y.copy(), s.copy()
    out, sout = np.empty(15), np.empty((n, 6))
    total, stotal = np.zeros(15), np.zeros((n, 6))
    for stage in range(4):
        rates(at, swung, out, sout, asked, torque, figures, inertia, rig, tanks)
        weight = 1.0 if stage % 3 == 0 else 2.0
        part = dt if stage == 2 else 0.5 * dt
        total += weight * out
        stotal += weight * sout
        at[:] = y + part * out
        swung[:] = s + part * sout
    y += dt / 6.0 * total
    s += dt / 6.0 * stotal
    y[6:10] /= np.sqrt(np.sum(y[6:10] ** 2))
    for t in range(n):
        s[t, :3] /= np.sqrt(np.sum(s[t, :3] ** 2))
        s[t, 3:] -= np.sum(s[t, 3:] * s[t, :3]) * s[t, :3]
    y[13] = max(y[13], dry - rig[16] - dt * rig[3])
