# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled rigid-body motion.

State vector y (15,): position, velocity (ENU), quaternion (scalar last), body rate, mass, thrust.
"""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import rotation_vector_between
from lunarsim._jit import kernel

# Batch size of the specialised (SIMD) code path.
SIMD_BATCH = 32


@kernel(exact=True)
def rates(
    y, y_start, out, out_start, n, width, thrust_command, tx, ty, tz, gravity, exhaust, lag, dry,
    wet, i_dry, i_wet, rig,
):  # fmt: skip
    """Write the state derivative of body n, on a flat Moon with uniform gravity.

    `y` is a flat array with the states of `width` bodies from index `y_start` on: one row per state
    variable, one column per body. `out` receives the derivatives from index `out_start` on.
    `thrust_command` is the input of the engine's lag, N, with the time constant `lag`, s; `exhaust`
    is the exhaust velocity, m/s. `tx`, `ty`, `tz` are torques about the origin of the body axes,
    N m; `dry`, `wet`, `i_dry` and `i_wet` are masses and moments of inertia with tanks empty and
    full; `rig` is from `build_rig`. The equations are those of `Dynamics`. If `width` is a
    constant, the compiler sees that rows do not overlap and vectorises over bodies.
    """
    qx = y[y_start + 6 * width + n]
    qy = y[y_start + 7 * width + n]
    qz = y[y_start + 8 * width + n]
    qw = y[y_start + 9 * width + n]
    wx = y[y_start + 10 * width + n]
    wy = y[y_start + 11 * width + n]
    wz = y[y_start + 12 * width + n]
    thrust = y[y_start + 14 * width + n]
    mass = y[y_start + 13 * width + n]
    ex, ey, ez = thrust * rig[4], thrust * rig[5], thrust * rig[6]
    fx, fy, fz = ex + rig[0], ey + rig[1], ez + rig[2]
    ax, ay, az = fx / mass, fy / mass, fz / mass
    out[out_start + n] = y[y_start + 3 * width + n]
    out[out_start + width + n] = y[y_start + 4 * width + n]
    out[out_start + 2 * width + n] = y[y_start + 5 * width + n]
    # The engine thrust alone is along body z, the third column of the direction cosine matrix.
    out[out_start + 3 * width + n] = az * 2.0 * (qx * qz + qw * qy) + (
        ax * (1.0 - 2.0 * (qy * qy + qz * qz)) + ay * 2.0 * (qx * qy - qw * qz)
    )
    out[out_start + 4 * width + n] = az * 2.0 * (qy * qz - qw * qx) + (
        ax * 2.0 * (qx * qy + qw * qz) + ay * (1.0 - 2.0 * (qx * qx + qz * qz))
    )
    out[out_start + 5 * width + n] = (
        az * (1.0 - 2.0 * (qx * qx + qy * qy))
        - gravity
        + (ax * 2.0 * (qx * qz - qw * qy) + ay * 2.0 * (qy * qz + qw * qx))
    )
    out[out_start + 6 * width + n] = 0.5 * (qw * wx + qy * wz - qz * wy)
    out[out_start + 7 * width + n] = 0.5 * (qw * wy + qz * wx - qx * wz)
    out[out_start + 8 * width + n] = 0.5 * (qw * wz + qx * wy - qy * wx)
    out[out_start + 9 * width + n] = -0.5 * (qx * wx + qy * wy + qz * wz)
    full = (mass - dry) / (wet - dry)
    ix = i_dry[0] + full * (i_wet[0] - i_dry[0])
    iy = i_dry[1] + full * (i_wet[1] - i_dry[1])
    iz = i_dry[2] + full * (i_wet[2] - i_dry[2])
    cx = rig[10] + full * (rig[13] - rig[10])
    cy = rig[11] + full * (rig[14] - rig[11])
    cz = rig[12] + full * (rig[15] - rig[12])
    # The engine pushes at its pivot; all forces cause torques about the centre of mass.
    mx = rig[8] * ez - rig[9] * ey - (cy * fz - cz * fy)
    my = rig[9] * ex - rig[7] * ez - (cz * fx - cx * fz)
    mz = rig[7] * ey - rig[8] * ex - (cx * fy - cy * fx)
    out[out_start + 10 * width + n] = (tx + mx - (iz - iy) * wy * wz) / ix
    out[out_start + 11 * width + n] = (ty + my - (ix - iz) * wz * wx) / iy
    out[out_start + 12 * width + n] = (tz + mz - (iy - ix) * wx * wy) / iz
    out[out_start + 13 * width + n] = -thrust / exhaust - rig[3]
    out[out_start + 14 * width + n] = (thrust_command - thrust) / lag if lag > 0.0 else 0.0


@kernel(exact=True)
def add_round_moon_terms(y, y_start, out, out_start, n, width, gravity, rig):
    """Add the terms of a spherical, rotating Moon to the derivative from `rates`.

    Gravity varies with position, and the rotation adds Coriolis and centrifugal accelerations.
    `rig[17]` is the radius, m, and `rig[18:21]` the angular velocity, ENU, rad/s. The other
    arguments are those of `rates`.
    """
    radius = rig[17]
    wx = rig[18]
    wy = rig[19]
    wz = rig[20]
    x = y[y_start + n]
    z = y[y_start + 2 * width + n] + radius
    vx = y[y_start + 3 * width + n]
    vy = y[y_start + 4 * width + n]
    vz = y[y_start + 5 * width + n]
    square = x * x + y[y_start + width + n] * y[y_start + width + n] + z * z
    pull = gravity * radius * radius / (square * np.sqrt(square))
    # Velocity of the frame at this position: spin x r.
    fx = wy * z - wz * y[y_start + width + n]
    fy = wz * x - wx * z
    fz = wx * y[y_start + width + n] - wy * x
    ux = 2.0 * vx + fx
    uy = 2.0 * vy + fy
    uz = 2.0 * vz + fz
    out[out_start + 3 * width + n] -= pull * x + (wy * uz - wz * uy)
    out[out_start + 4 * width + n] -= pull * y[y_start + width + n] + (wz * ux - wx * uz)
    out[out_start + 5 * width + n] += gravity - pull * z - (wx * uy - wy * ux)


@kernel()
def derivative(y, out, thrust_command, torque, gravity, exhaust, lag, dry, wet, i_dry, i_wet, rig):
    """Write the derivative (15,) of the state `y` (15,) of one body into `out`.

    `thrust_command` is the input of the engine's lag, N, with the time constant `lag`, s; `exhaust`
    is the exhaust velocity, m/s. `torque` (3,) is about the origin of the body axes, N m; `dry`,
    `wet`, `i_dry` and `i_wet` are masses and moments of inertia with tanks empty and full; `rig`
    (21,) is from `build_rig`.
    """
    rates(
        y, 0, out, 0, 0, 1, thrust_command, torque[0], torque[1], torque[2], gravity, exhaust, lag,
        dry, wet, i_dry, i_wet, rig,
    )  # fmt: skip
    if rig[17] > 0.0:
        add_round_moon_terms(y, 0, out, 0, 0, 1, gravity, rig)


@kernel(exact=True)
def _flat_step(y, dt, thrust_command, torque, params, inertia, rig, work, width):
    """Advance `width` bodies by one Runge-Kutta step of `dt` seconds in place.

    The arguments are those of `rk4_step`, with the arrays of the bodies flattened row by row.
    """
    size = 15 * width
    i_dry = (inertia[0, 0], inertia[0, 1], inertia[0, 2])
    i_wet = (inertia[1, 0], inertia[1, 1], inertia[1, 2])
    rig_values = (
        rig[0], rig[1], rig[2], rig[3], rig[4], rig[5], rig[6], rig[7], rig[8], rig[9], rig[10],
        rig[11], rig[12], rig[13], rig[14], rig[15], rig[16], rig[17], rig[18], rig[19], rig[20],
    )  # fmt: skip
    for n in range(width):
        if params[2 * width + n] == 0.0:
            y[14 * width + n] = thrust_command[n]
    # Stage states are stored behind the four derivatives.
    at = 4 * size
    for j in range(size):
        work[at + j] = y[j]
    for stage in range(4):
        into = stage * size
        for n in range(width):
            rates(
                work, at, work, into, n, width, thrust_command[n], torque[n], torque[width + n],
                torque[2 * width + n], params[n], params[width + n], params[2 * width + n],
                params[3 * width + n], params[4 * width + n], i_dry, i_wet, rig_values,
            )  # fmt: skip
        if rig_values[17] > 0.0:
            for n in range(width):
                add_round_moon_terms(work, at, work, into, n, width, params[n], rig_values)
        if stage < 3:
            part = dt if stage == 2 else 0.5 * dt
            for j in range(size):
                work[at + j] = y[j] + part * work[into + j]
    for j in range(size):
        y[j] += (
            dt / 6.0 * (work[j] + 2.0 * (work[size + j] + work[2 * size + j]) + work[3 * size + j])
        )
    for n in range(width):
        norm = np.sqrt(
            y[6 * width + n] * y[6 * width + n]
            + y[7 * width + n] * y[7 * width + n]
            + y[8 * width + n] * y[8 * width + n]
            + y[9 * width + n] * y[9 * width + n]
        )
        for s in range(6, 10):
            y[s * width + n] /= norm


@kernel(inner=True)
def rk4_step(y, dt, thrust_command, torque, params, inertia, rig, work):
    """Advance bodies `y` (15, N) by one Runge-Kutta step of `dt` seconds in place.

    `thrust_command` (N,) and `torque` (3, N) are the commands of each body, `params` (5, N) its
    parameters (gravity, exhaust velocity, thrust lag, dry and wet mass); `inertia` (2, 3) are the
    principal moments of inertia, tanks empty and full; `rig` (21,) is from `build_rig`; `work` is
    scratch (5, 15, N). A batch of `SIMD_BATCH` bodies is vectorised.
    """
    n = y.shape[1]
    flat, turn = y.reshape(15 * n), torque.reshape(3 * n)
    rig_values, work_flat = params.reshape(5 * n), work.reshape(75 * n)
    if n == SIMD_BATCH:
        _flat_step(flat, dt, thrust_command, turn, rig_values, inertia, rig, work_flat, SIMD_BATCH)
    else:
        _flat_step(flat, dt, thrust_command, turn, rig_values, inertia, rig, work_flat, n)


@kernel()
def advance_bodies(y, dt, thrust_command, torque, params, inertia, rig, work):
    """Advance bodies (15, N) by one step in place, with limited propellant.

    For an engine without propellant, `thrust_command` and thrust become 0; no mass falls below that
    of empty tanks. The arguments are those of `rk4_step`.
    """
    # Thruster propellant is summed elsewhere: allow for rounding.
    thruster_propellant = (1.0 - 1e-6) * rig[16]
    for n in range(y.shape[1]):
        if y[13, n] <= params[3, n] - thruster_propellant:
            thrust_command[n] = 0.0
            y[14, n] = 0.0
    rk4_step(y, dt, thrust_command, torque, params, inertia, rig, work)
    for n in range(y.shape[1]):
        y[13, n] = max(y[13, n], params[3, n] - rig[16] - dt * rig[3])


@kernel()
def advance_body(y, dt, thrust, torque, params, inertia, rig, work):
    """Advance the state `y` (15,) of one body by a step of `dt` seconds in place.

    `thrust` is the input of the engine's lag, N, and `torque` (3,) about the body's origin, N m.
    `params`: gravity, exhaust velocity, thrust lag, dry and wet mass; `inertia` (2, 3): principal
    moments of inertia, tanks empty and full; `rig` (21,): from `build_rig`; `work`: scratch
    (5, 15).
    """
    thrust_command = np.empty(1)
    thrust_command[0] = thrust
    turn = np.empty((3, 1))
    for k in range(3):
        turn[k, 0] = torque[k]
    advance_bodies(
        y.reshape(15, 1), dt, thrust_command, turn, params.reshape(5, 1), inertia, rig,
        work.reshape(5, 15, 1),
    )  # fmt: skip


@kernel()
def advance_ideal(y, steps, dt, thrust, target, slew, params, inertia, rig):
    """Advance a state with an ideal attitude actuator; return all states (steps, 15).

    The attitude follows the great circle to the quaternion `target` (4,) at `slew` (rad/s) or less.
    `y` (15,) is advanced in place; the other arguments are those of `advance_body`.
    """
    history = np.empty((steps, 15))
    work = np.empty((5, 15))
    torque = np.zeros(3)
    phi = np.empty(3)
    q = np.empty(4)
    for n in range(steps):
        angle = rotation_vector_between(y[6:10], target, phi)
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
        advance_body(y, dt, thrust, torque, params, inertia, rig, work)
        for s in range(4):
            y[6 + s] = q[s]
        for s in range(3):
            y[10 + s] = share * phi[s] / dt
        for s in range(15):
            history[n, s] = y[s]
    return history
