# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled contact of legs with the terrain, added to the rigid-body derivative.

The state of a leg is (5,): crushed length, compression of spring and damper, and the contact point
to which its pad sticks (3,), NaN while the pad is free.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.core.touchdown import height_at
from lunarsim.vehicle._kernels import derivative


@kernel(inner=True)
def crush_limit(leg_state, leg_params):
    """Return the crush force of a leg, N; infinite once its stroke is used up.

    `leg_state` (5,) begins with the crushed length, m; `leg_params` (6,) are those of
    `compute_contact`.
    """
    return leg_params[2] if leg_state[0] < leg_params[5] else np.inf


@kernel()
def compute_contact(y, pad, leg_state, leg_params, heights, frame, out):
    """Compute the contact force of a pad; return whether it is in contact.

    `y` (15,) is the lander's state and `pad` (3,) the pad in body axes, m. `leg_state` (5,) is the
    crushed length, the compression of spring and damper, and the contact point to which the pad
    sticks (3,), NaN for a free pad. `leg_params` (6,) is stiffness, damping, crush force, friction,
    radius of the pad, stroke. `heights` and `frame` are the raster of `TerrainPatch`; unknown
    terrain gives no contact. `out` (12,): force (3), position (3), velocity (3) of the pad, ENU;
    compression of spring and damper, its rate, and the normal force before the crush limit.
    """
    qx, qy, qz, qw = y[6], y[7], y[8], y[9]
    wx, wy, wz = y[10], y[11], y[12]
    spin = np.empty(3)
    spin[0] = wy * pad[2] - wz * pad[1]
    spin[1] = wz * pad[0] - wx * pad[2]
    spin[2] = wx * pad[1] - wy * pad[0]
    for k in range(3):
        v = pad if k == 0 else spin
        cx = qy * v[2] - qz * v[1] + qw * v[0]
        cy = qz * v[0] - qx * v[2] + qw * v[1]
        cz = qx * v[1] - qy * v[0] + qw * v[2]
        if k == 0:
            out[3] = y[0] + v[0] + 2.0 * (qy * cz - qz * cy)
            out[4] = y[1] + v[1] + 2.0 * (qz * cx - qx * cz)
            out[5] = y[2] + v[2] + 2.0 * (qx * cy - qy * cx)
        elif k == 1:
            out[6] = y[3] + v[0] + 2.0 * (qy * cz - qz * cy)
            out[7] = y[4] + v[1] + 2.0 * (qz * cx - qx * cz)
            out[8] = y[5] + v[2] + 2.0 * (qx * cy - qy * cx)
    out[0] = out[1] = out[2] = out[9] = out[10] = out[11] = 0.0
    px, py, r = out[3], out[4], leg_params[4]
    top = height_at(heights, frame, px, py)
    gx = (height_at(heights, frame, px + r, py) - height_at(heights, frame, px - r, py)) / (2.0 * r)
    gy = (height_at(heights, frame, px, py + r) - height_at(heights, frame, px, py - r)) / (2.0 * r)
    if not (np.isfinite(top) and np.isfinite(gx) and np.isfinite(gy)):
        return False
    nz = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
    nx, ny = -gx * nz, -gy * nz
    pressed = (top - out[5]) * nz - leg_state[0]
    if pressed <= 0.0:
        return False
    into = -(out[6] * nx + out[7] * ny + out[8] * nz)
    out[9], out[10] = pressed, into
    out[11] = leg_params[0] * pressed + leg_params[1] * into
    normal = min(max(out[11], 0.0), crush_limit(leg_state, leg_params))
    add_friction(out, leg_state, leg_params, (nx, ny, nz), normal)
    return True


@kernel(inner=True)
def add_friction(out, leg_state, leg_params, terrain_normal, normal_force):
    """Write the force of the terrain on a pad (normal and friction) into `out[:3]`.

    Friction acts as a spring and damper at the contact point, up to the friction limit.
    `terrain_normal` is the terrain normal (3,) and `normal_force` the normal force, N; `leg_state`,
    `leg_params` and `out` are those of `compute_contact`.
    """
    hold = np.zeros(3)
    if np.isfinite(leg_state[2]):
        off = np.empty(3)
        for k in range(3):
            off[k] = leg_params[0] * (out[3 + k] - leg_state[2 + k]) + leg_params[1] * out[6 + k]
        along = off[0] * terrain_normal[0] + off[1] * terrain_normal[1] + off[2] * terrain_normal[2]
        size = 0.0
        for k in range(3):
            hold[k] = -(off[k] - along * terrain_normal[k])
            size += hold[k] * hold[k]
        size = np.sqrt(size)
        if size > leg_params[3] * normal_force:
            for k in range(3):
                hold[k] *= leg_params[3] * normal_force / size
    for k in range(3):
        out[k] = normal_force * terrain_normal[k] + hold[k]


@kernel(inner=True)
def compute_loads(y, pads, leg_states, leg_params, heights, frame, rig, torque, out):
    """Compute force and torque of all legs on the body; return the absorbed power, W.

    The total force is written into `rig[:3]` and the torque into `torque`, body axes. `pads` (n, 3)
    are in body axes, m, `leg_states` (n, 5) the states of the legs; `out` (12,) is scratch. The
    other arguments are those of `compute_contact`.
    """
    power = 0.0
    total = np.zeros(3)
    turn = np.zeros(3)
    for n in range(pads.shape[0]):
        if not compute_contact(y, pads[n], leg_states[n], leg_params, heights, frame, out):
            continue
        ax, ay, az = out[3] - y[0], out[4] - y[1], out[5] - y[2]
        turn[0] += ay * out[2] - az * out[1]
        turn[1] += az * out[0] - ax * out[2]
        turn[2] += ax * out[1] - ay * out[0]
        for k in range(3):
            total[k] += out[k]
            power -= out[k] * out[6 + k]
    x, yy, z, w = y[6], y[7], y[8], y[9]
    for k in range(2):
        v = total if k == 0 else turn
        cx = yy * v[2] - z * v[1] - w * v[0]
        cy = z * v[0] - x * v[2] - w * v[1]
        cz = x * v[1] - yy * v[0] - w * v[2]
        into = rig if k == 0 else torque
        into[0] = v[0] + 2.0 * (yy * cz - z * cy)
        into[1] = v[1] + 2.0 * (z * cx - x * cz)
        into[2] = v[2] + 2.0 * (x * cy - yy * cx)
    return power


@kernel(inner=True)
def update_yield(y, dt, pads, leg_states, leg_params, heights, frame, out):
    """Update crushed lengths and slipping contact points of the legs after a step.

    `leg_states` (n, 5) are the states of the legs, in place, and `dt` is the step, s; `out` (12,)
    is scratch. The other arguments are those of `compute_contact`.
    """
    for n in range(pads.shape[0]):
        leg_state = leg_states[n]
        if not compute_contact(y, pads[n], leg_state, leg_params, heights, frame, out):
            leg_state[1] = 0.0
            leg_state[2] = leg_state[3] = leg_state[4] = np.nan
            continue
        most = crush_limit(leg_state, leg_params)
        give = 0.0
        if out[11] > most:
            # At the crush force, spring and damper relax towards it; the honeycomb crushes by the
            # rest.
            level = most / leg_params[0]
            left = level + (leg_state[1] - level) * np.exp(-dt * leg_params[0] / leg_params[1])
            give = max(out[9] - left, 0.0)
            leg_state[0] += give
        leg_state[1] = out[9] - give
        normal = min(max(out[11], 0.0), crush_limit(leg_state, leg_params))
        if not np.isfinite(leg_state[2]):
            for k in range(3):
                leg_state[2 + k] = out[3 + k]
            continue
        size = 0.0
        for k in range(3):
            off = leg_params[0] * (out[3 + k] - leg_state[2 + k])
            size += off * off
        size = np.sqrt(size)
        if size > leg_params[3] * normal:
            for k in range(3):
                leg_state[2 + k] = (
                    out[3 + k] - (out[3 + k] - leg_state[2 + k]) * leg_params[3] * normal / size
                )


@kernel()
def settle(y, steps, dt, pads, leg_states, leg_params, heights, frame, params, inertia, rig):
    """Simulate the motion of a lander on its legs, engine off, by Runge-Kutta steps.

    `y` (15,) and the leg states `leg_states` (n, 5) advance in place by `steps` steps of `dt`
    seconds. `pads` (n, 3) are in body axes, m; `leg_params`, `heights` and `frame` are those of
    `compute_contact`, `params`, `inertia` and `rig` those of `advance_body`. Returns the energy
    absorbed by the legs, including stored energy, J.
    """
    work = np.empty((5, 15))
    out = np.empty(12)
    torque = np.empty(3)
    power = np.empty(4)
    absorbed = 0.0
    for _ in range(steps):
        for stage in range(4):
            here = y if stage == 0 else work[4]
            power[stage] = compute_loads(
                here, pads, leg_states, leg_params, heights, frame, rig, torque, out
            )
            derivative(
                here, work[stage], 0.0, torque, params[0], params[1], 0.0, params[3], params[4],
                inertia[0], inertia[1], rig,
            )  # fmt: skip
            if stage < 3:
                reach = dt if stage == 2 else 0.5 * dt
                for s in range(15):
                    work[4, s] = y[s] + reach * work[stage, s]
        for s in range(15):
            y[s] += dt / 6.0 * (work[0, s] + 2.0 * (work[1, s] + work[2, s]) + work[3, s])
        absorbed += dt / 6.0 * (power[0] + 2.0 * (power[1] + power[2]) + power[3])
        norm = np.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
        for s in range(6, 10):
            y[s] /= norm
        update_yield(y, dt, pads, leg_states, leg_params, heights, frame, out)
    return absorbed
