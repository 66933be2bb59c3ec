"""Compiled rigid-body motion.

State vector y (15,): position, velocity (ENU), quaternion (scalar last), body rate, mass, thrust.
"""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import rotation_between
from lunarsim._jit import kernel


@kernel()
def derivative(y, out, thrust_command, torque, gravity, exhaust, lag, dry, wet, i_dry, i_wet, rig):
    """Write dy/dt; see `Dynamics` for the equations, and `rig_of` for `rig` (17,).

    Torques are about the origin of the body axes.
    """
    qx = y[6]
    qy = y[7]
    qz = y[8]
    qw = y[9]
    wx = y[10]
    wy = y[11]
    wz = y[12]
    ex = y[14] * rig[4]
    ey = y[14] * rig[5]
    ez = y[14] * rig[6]
    fx = ex + rig[0]
    fy = ey + rig[1]
    fz = ez + rig[2]
    ax = fx / y[13]
    ay = fy / y[13]
    az = fz / y[13]
    out[0] = y[3]
    out[1] = y[4]
    out[2] = y[5]
    # The engine alone pushes along body z, the third column of the direction cosine matrix.
    out[3] = az * 2.0 * (qx * qz + qw * qy) + (
        ax * (1.0 - 2.0 * (qy * qy + qz * qz)) + ay * 2.0 * (qx * qy - qw * qz)
    )
    out[4] = az * 2.0 * (qy * qz - qw * qx) + (
        ax * 2.0 * (qx * qy + qw * qz) + ay * (1.0 - 2.0 * (qx * qx + qz * qz))
    )
    out[5] = (
        az * (1.0 - 2.0 * (qx * qx + qy * qy))
        - gravity
        + (ax * 2.0 * (qx * qz - qw * qy) + ay * 2.0 * (qy * qz + qw * qx))
    )
    out[6] = 0.5 * (qw * wx + qy * wz - qz * wy)
    out[7] = 0.5 * (qw * wy + qz * wx - qx * wz)
    out[8] = 0.5 * (qw * wz + qx * wy - qy * wx)
    out[9] = -0.5 * (qx * wx + qy * wy + qz * wz)
    full = (y[13] - dry) / (wet - dry)
    ix = i_dry[0] + full * (i_wet[0] - i_dry[0])
    iy = i_dry[1] + full * (i_wet[1] - i_dry[1])
    iz = i_dry[2] + full * (i_wet[2] - i_dry[2])
    cx = rig[10] + full * (rig[13] - rig[10])
    cy = rig[11] + full * (rig[14] - rig[11])
    cz = rig[12] + full * (rig[15] - rig[12])
    # The engine pushes at its pivot; all forces turn the body about its centre of mass.
    tx = rig[8] * ez - rig[9] * ey - (cy * fz - cz * fy)
    ty = rig[9] * ex - rig[7] * ez - (cz * fx - cx * fz)
    tz = rig[7] * ey - rig[8] * ex - (cx * fy - cy * fx)
    out[10] = (torque[0] + tx - (iz - iy) * wy * wz) / ix
    out[11] = (torque[1] + ty - (ix - iz) * wz * wx) / iy
    out[12] = (torque[2] + tz - (iy - ix) * wx * wy) / iz
    out[13] = -y[14] / exhaust - rig[3]
    out[14] = (thrust_command - y[14]) / lag if lag > 0.0 else 0.0


@kernel(inner=True)
def rk4_step(
    y, dt, thrust_command, torque, gravity, exhaust, lag, dry, wet, i_dry, i_wet, rig, work
):
    """Advance y by one classical Runge-Kutta step in place; `work` is scratch (5, 15)."""
    args = (thrust_command, torque, gravity, exhaust, lag, dry, wet, i_dry, i_wet, rig)
    if lag == 0.0:
        y[14] = thrust_command
    derivative(y, work[0], *args)
    for s in range(15):
        work[4, s] = y[s] + 0.5 * dt * work[0, s]
    derivative(work[4], work[1], *args)
    for s in range(15):
        work[4, s] = y[s] + 0.5 * dt * work[1, s]
    derivative(work[4], work[2], *args)
    for s in range(15):
        work[4, s] = y[s] + dt * work[2, s]
    derivative(work[4], work[3], *args)
    for s in range(15):
        y[s] += dt / 6.0 * (work[0, s] + 2.0 * (work[1, s] + work[2, s]) + work[3, s])
    norm = np.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
    for s in range(6, 10):
        y[s] /= norm


@kernel()
def advance_body(y, dt, thrust, torque, figures, inertia, rig, work):
    """Advance y by one step under a thrust and torques in place.

    `figures` is gravity, exhaust velocity, thrust lag, dry and wet mass; `inertia` (2, 3) the
    principal moments with tanks empty and full; `rig` (17,) see `rig_of`.
    """
    dry = figures[3]
    # What thrusters have spent is summed up elsewhere: leave room for its rounding.
    if y[13] <= dry - (1.0 - 1e-6) * rig[16]:  # tanks empty
        thrust = 0.0
        y[14] = 0.0
    rk4_step(
        y, dt, thrust, torque, figures[0], figures[1], figures[2], dry, figures[4], inertia[0],
        inertia[1], rig, work,
    )  # fmt: skip
    y[13] = max(y[13], dry - rig[16] - dt * rig[3])


@kernel()
def advance_ideal(y, steps, dt, thrust, target, slew, figures, inertia, rig):
    """Advance y by `steps` steps with an ideal attitude actuator; return every state (steps, 15).

    The attitude goes along the great circle to `target` at no more than `slew` (rad/s).
    """
    history = np.empty((steps, 15))
    work = np.empty((5, 15))
    torque = np.zeros(3)
    phi = np.empty(3)
    q = np.empty(4)
    for n in range(steps):
        angle = rotation_between(y[6:10], target, phi)
        turn = min(angle, slew * dt)
        share = turn / angle if angle > 1e-12 else 0.0
        half = 0.5 * turn
        sinc = 0.5 * share * (np.sin(half) / half if half > 1e-9 else 1.0)
        rx = phi[0] * sinc
        ry = phi[1] * sinc
        rz = phi[2] * sinc
        rw = np.cos(half)
        q[0] = y[9] * rx + y[6] * rw + y[7] * rz - y[8] * ry
        q[1] = y[9] * ry - y[6] * rz + y[7] * rw + y[8] * rx
        q[2] = y[9] * rz + y[6] * ry - y[7] * rx + y[8] * rw
        q[3] = y[9] * rw - y[6] * rx - y[7] * ry - y[8] * rz
        for s in range(3):
            y[10 + s] = 0.0
        advance_body(y, dt, thrust, torque, figures, inertia, rig, work)
        for s in range(4):
            y[6 + s] = q[s]
        for s in range(3):
            y[10 + s] = share * phi[s] / dt
        for s in range(15):
            history[n, s] = y[s]
    return history
