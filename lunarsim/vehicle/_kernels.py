"""Compiled rigid-body motion.

State vector y (15,): position, velocity (ENU), quaternion (scalar last), body rate, mass, thrust.
"""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import rotation_between
from lunarsim._jit import kernel


@kernel(exact=True)
def rates(y, out, n, asked, tx, ty, tz, gravity, exhaust, lag, dry, wet, i_dry, i_wet, rig):
    """Write dy/dt of body n, of states (15, N); see `Dynamics` for the equations and `rig_of`.

    Torques are about the origin of the body axes. Bodies lie side by side, so that the compiler
    takes some of them at a time.
    """
    qx = y[6, n]
    qy = y[7, n]
    qz = y[8, n]
    qw = y[9, n]
    wx = y[10, n]
    wy = y[11, n]
    wz = y[12, n]
    thrust = y[14, n]
    mass = y[13, n]
    ex = thrust * rig[4]
    ey = thrust * rig[5]
    ez = thrust * rig[6]
    fx = ex + rig[0]
    fy = ey + rig[1]
    fz = ez + rig[2]
    ax = fx / mass
    ay = fy / mass
    az = fz / mass
    out[0, n] = y[3, n]
    out[1, n] = y[4, n]
    out[2, n] = y[5, n]
    # The engine alone pushes along body z, the third column of the direction cosine matrix.
    out[3, n] = az * 2.0 * (qx * qz + qw * qy) + (
        ax * (1.0 - 2.0 * (qy * qy + qz * qz)) + ay * 2.0 * (qx * qy - qw * qz)
    )
    out[4, n] = az * 2.0 * (qy * qz - qw * qx) + (
        ax * 2.0 * (qx * qy + qw * qz) + ay * (1.0 - 2.0 * (qx * qx + qz * qz))
    )
    out[5, n] = (
        az * (1.0 - 2.0 * (qx * qx + qy * qy))
        - gravity
        + (ax * 2.0 * (qx * qz - qw * qy) + ay * 2.0 * (qy * qz + qw * qx))
    )
    out[6, n] = 0.5 * (qw * wx + qy * wz - qz * wy)
    out[7, n] = 0.5 * (qw * wy + qz * wx - qx * wz)
    out[8, n] = 0.5 * (qw * wz + qx * wy - qy * wx)
    out[9, n] = -0.5 * (qx * wx + qy * wy + qz * wz)
    full = (mass - dry) / (wet - dry)
    ix = i_dry[0] + full * (i_wet[0] - i_dry[0])
    iy = i_dry[1] + full * (i_wet[1] - i_dry[1])
    iz = i_dry[2] + full * (i_wet[2] - i_dry[2])
    cx = rig[10] + full * (rig[13] - rig[10])
    cy = rig[11] + full * (rig[14] - rig[11])
    cz = rig[12] + full * (rig[15] - rig[12])
    # The engine pushes at its pivot; all forces turn the body about its centre of mass.
    mx = rig[8] * ez - rig[9] * ey - (cy * fz - cz * fy)
    my = rig[9] * ex - rig[7] * ez - (cz * fx - cx * fz)
    mz = rig[7] * ey - rig[8] * ex - (cx * fy - cy * fx)
    out[10, n] = (tx + mx - (iz - iy) * wy * wz) / ix
    out[11, n] = (ty + my - (ix - iz) * wz * wx) / iy
    out[12, n] = (tz + mz - (iy - ix) * wx * wy) / iz
    out[13, n] = -thrust / exhaust - rig[3]
    out[14, n] = (asked - thrust) / lag if lag > 0.0 else 0.0


@kernel(exact=True)
def curve(y, out, n, gravity, rig):
    """Add to dy/dt of body n what a round, turning Moon changes; see `Dynamics`.

    Gravity grows and turns with the place, and the frame's turning adds Coriolis and centrifugal
    accelerations. `rig[17]` is the radius, m, and `rig[18:21]` the spin, ENU, rad/s.
    """
    radius = rig[17]
    wx = rig[18]
    wy = rig[19]
    wz = rig[20]
    x = y[0, n]
    z = y[2, n] + radius
    vx = y[3, n]
    vy = y[4, n]
    vz = y[5, n]
    square = x * x + y[1, n] * y[1, n] + z * z
    pull = gravity * radius * radius / (square * np.sqrt(square))
    # Of the frame at this place: spin x r.
    fx = wy * z - wz * y[1, n]
    fy = wz * x - wx * z
    fz = wx * y[1, n] - wy * x
    ux = 2.0 * vx + fx
    uy = 2.0 * vy + fy
    uz = 2.0 * vz + fz
    out[3, n] -= pull * x + (wy * uz - wz * uy)
    out[4, n] -= pull * y[1, n] + (wz * ux - wx * uz)
    out[5, n] += gravity - pull * z - (wx * uy - wy * ux)


@kernel()
def derivative(y, out, thrust_command, torque, gravity, exhaust, lag, dry, wet, i_dry, i_wet, rig):
    """Write dy/dt (15,) of one body; see `rates`."""
    rates(
        y.reshape(15, 1), out.reshape(15, 1), 0, thrust_command, torque[0], torque[1], torque[2],
        gravity, exhaust, lag, dry, wet, i_dry, i_wet, rig,
    )  # fmt: skip
    if rig[17] > 0.0:
        curve(y.reshape(15, 1), out.reshape(15, 1), 0, gravity, rig)


@kernel(inner=True)
def rk4_step(y, dt, asked, torque, figures, inertia, rig, work):
    """Advance bodies (15, N) by one classical Runge-Kutta step in place.

    `asked` (N,) and `torque` (3, N) are what each is commanded, `figures` (5, N) its own; `work` is
    scratch (5, 15, N); for the others see `advance_body`.
    """
    i_dry, i_wet = inertia[0], inertia[1]
    bodies = y.shape[1]
    for n in range(bodies):
        if figures[2, n] == 0.0:
            y[14, n] = asked[n]
    for stage in range(4):
        at = y if stage == 0 else work[4]
        for n in range(bodies):
            rates(
                at, work[stage], n, asked[n], torque[0, n], torque[1, n], torque[2, n],
                figures[0, n], figures[1, n], figures[2, n], figures[3, n], figures[4, n], i_dry,
                i_wet, rig,
            )  # fmt: skip
        if rig[17] > 0.0:
            for n in range(bodies):
                curve(at, work[stage], n, figures[0, n], rig)
        if stage < 3:
            part = dt if stage == 2 else 0.5 * dt
            for s in range(15):
                for n in range(bodies):
                    work[4, s, n] = y[s, n] + part * work[stage, s, n]
    for s in range(15):
        for n in range(bodies):
            y[s, n] += (
                dt / 6.0 * (work[0, s, n] + 2.0 * (work[1, s, n] + work[2, s, n]) + work[3, s, n])
            )
    for n in range(bodies):
        norm = np.sqrt(
            y[6, n] * y[6, n] + y[7, n] * y[7, n] + y[8, n] * y[8, n] + y[9, n] * y[9, n]
        )
        for s in range(6, 10):
            y[s, n] /= norm


@kernel()
def advance_bodies(y, dt, asked, torque, figures, inertia, rig, work):
    """Advance bodies (15, N) by one step under thrusts (N,) and torques (3, N) in place.

    What is asked of an engine without propellant becomes 0. `figures` (5, N) are each body's own;
    for the others see `advance_body`; `work` is scratch (5, 15, N).
    """
    # What thrusters have spent is summed up elsewhere: leave room for its rounding.
    room = (1.0 - 1e-6) * rig[16]
    for n in range(y.shape[1]):
        if y[13, n] <= figures[3, n] - room:
            asked[n] = 0.0
            y[14, n] = 0.0
    rk4_step(y, dt, asked, torque, figures, inertia, rig, work)
    for n in range(y.shape[1]):
        y[13, n] = max(y[13, n], figures[3, n] - rig[16] - dt * rig[3])


@kernel()
def advance_body(y, dt, thrust, torque, figures, inertia, rig, work):
    """Advance y (15,) by one step under a thrust and torques (3,) in place.

    `figures` is gravity, exhaust velocity, thrust lag, dry and wet mass; `inertia` (2, 3) the
    principal moments with tanks empty and full; `rig` (21,) see `rig_of`; `work` scratch (5, 15).
    """
    asked = np.empty(1)
    asked[0] = thrust
    turn = np.empty((3, 1))
    for k in range(3):
        turn[k, 0] = torque[k]
    advance_bodies(
        y.reshape(15, 1), dt, asked, turn, figures.reshape(5, 1), inertia, rig,
        work.reshape(5, 15, 1),
    )  # fmt: skip


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
