"""Motion of a rigid body with SciPy's rotations and integrator."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation


def rate_of_change(y, thrust_command, torque, gravity, exhaust, lag, dry, wet, i_dry, i_wet):
    """Return dy/dt of (position, velocity, quaternion, body rate, mass, thrust) (15,)."""
    velocity, q, rate, mass, thrust = y[3:6], y[6:10], y[10:13], y[13], y[14]
    pull = Rotation.from_quat(q).as_matrix()[:, 2] * thrust / mass
    # A unit quaternion moves by half the product with the body rate as a pure quaternion.
    x, y_, z, w = q
    spread = np.array([[w, -z, y_], [z, w, -x], [-y_, x, w], [-x, -y_, -z]])
    inertia = np.diag(np.interp(mass, [dry, wet], [0.0, 1.0]) * (i_wet - i_dry) + i_dry)
    turn = np.linalg.solve(inertia, torque - np.cross(rate, inertia @ rate))
    spool = (thrust_command - thrust) / lag if lag > 0.0 else 0.0
    return np.concatenate(
        (
            velocity,
            pull - [0.0, 0.0, gravity],
            0.5 * spread @ rate,
            turn,
            [-thrust / exhaust, spool],
        )
    )


def moved(y, time, *args):
    """Return y after a time."""
    return solve_ivp(
        lambda _, state: rate_of_change(state, *args), (0.0, time), y, method="DOP853",
        rtol=1e-12, atol=1e-12,
    ).y[:, -1]  # fmt: skip


def turned_towards(q, target, most):
    """Return the quaternion `most` rad along the shortest arc to another, and the turn (3,)."""
    start = Rotation.from_quat(q)
    arc = (start.inv() * Rotation.from_quat(target)).as_rotvec()
    angle = np.linalg.norm(arc)
    arc = arc * min(1.0, most / angle) if angle > 0.0 else arc
    return (start * Rotation.from_rotvec(arc)).as_quat(), arc


def rigged_rate_of_change(
    y, thrust_command, torque, gravity, exhaust, lag, dry, wet, i_dry, i_wet, *, force, flow,
    engine, pivot, com_dry, com_full,
):  # fmt: skip
    """Return dy/dt (15,) with thrusters that push, a swung engine and a moving centre of mass.

    Forces act where they are made; `torque` is that of the thrusters about the body's origin.
    """
    out = rate_of_change(
        y, thrust_command, np.zeros(3), gravity, exhaust, lag, dry, wet, i_dry, i_wet
    )
    q, rate, mass, thrust = y[6:10], y[10:13], y[13], y[14]
    push = thrust * np.asarray(engine)
    total = push + np.asarray(force)
    out[3:6] = Rotation.from_quat(q).apply(total) / mass - [0.0, 0.0, gravity]
    share = (mass - dry) / (wet - dry)
    com = np.asarray(com_dry) + share * (np.asarray(com_full) - np.asarray(com_dry))
    about = np.asarray(torque) - np.cross(com, force) + np.cross(np.asarray(pivot) - com, push)
    inertia = np.diag(i_dry + share * (i_wet - i_dry))
    out[10:13] = np.linalg.solve(inertia, about - np.cross(rate, inertia @ rate))
    out[13] -= flow
    return out
