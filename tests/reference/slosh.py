"""A rigid body and the bobs of spherical pendulums as bodies of their own, joined by rods."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation


def accelerations(v, w, force, torque, body, rods):
    """Return acceleration of the rest's centre, angular acceleration and those of the bobs.

    All in body axes and without gravity. `body` is mass, inertia (3, 3) about the centre of mass
    and that centre, of what does not swing; `rods` lists mass, hinge, bob, its velocity against
    the body, length and drag coefficient; `force` acts at the body's origin with `torque` about it.
    Unknown are the accelerations of the centre and of every bob, the turn, and each rod's pull.
    """
    mass, inertia, middle = body
    n = len(rods)
    a = np.zeros((6 + 4 * n, 6 + 4 * n))
    b = np.zeros(6 + 4 * n)
    a[:3, :3] = mass * np.eye(3)
    a[3:6, 3:6] = inertia
    b[:3] = force
    b[3:6] = torque - np.cross(middle, force) - np.cross(w, inertia @ w)
    for k, (m, hinge, bob, speed, length, drag) in enumerate(rods):
        here, pull = slice(6 + 4 * k, 9 + 4 * k), 9 + 4 * k
        u = (bob - hinge) / length
        slow = drag * speed
        b[:3] += slow
        b[3:6] += np.cross(bob - middle, slow)
        a[:3, pull] = -u
        a[3:6, pull] = -np.cross(hinge - middle, u)
        a[here, here] = m * np.eye(3)
        a[here, pull] = u
        b[here] = -slow
        # The rod keeps its length: (x_bob - x_hinge) . (x_bob - x_hinge)'' + |difference'|^2 = 0.
        arm = hinge - middle
        difference = speed + np.cross(w, bob - hinge)
        a[pull, here] = u
        a[pull, :3] = -u
        a[pull, 3:6] = -np.cross(arm, u)
        b[pull] = u @ np.cross(w, np.cross(w, arm)) - difference @ difference / length
    found = np.linalg.solve(a, b)
    return found[:3], found[3:6], [found[6 + 4 * k : 9 + 4 * k] for k in range(n)]


def rate_of_change(y, force, torque, gravity, body, rods):
    """Return dy/dt of a state of absolute places: centre, speed, quaternion, rate, bobs, speeds.

    `rods` lists mass, hinge in the body, length and drag coefficient.
    """
    mass, inertia, middle = body
    x, v, q, w = y[:3], y[3:6], y[6:10], y[10:13]
    turn = Rotation.from_quat(q)
    full = []
    for k, (m, hinge, length, drag) in enumerate(rods):
        place, speed = y[13 + 6 * k : 16 + 6 * k], y[16 + 6 * k : 19 + 6 * k]
        bob = middle + turn.inv().apply(place - x)
        against = turn.inv().apply(speed - v) - np.cross(w, bob - middle)
        full.append((m, hinge, bob, against, length, drag))
    a, alpha, bobs = accelerations(v, w, force, torque, body, full)
    down = np.array([0.0, 0.0, -gravity])
    spread = Rotation.from_quat(q).as_quat()
    s, axis = spread[3], spread[:3]
    dq = 0.5 * np.append(s * w + np.cross(axis, w), -axis @ w)
    out = [v, turn.apply(a) + down, dq, alpha]
    for k, one in enumerate(bobs):
        out += [y[16 + 6 * k : 19 + 6 * k], turn.apply(one) + down]
    return np.concatenate(out)


def moved(y, time, *args):
    """Return y after a time."""
    return solve_ivp(
        lambda _, now: rate_of_change(now, *args), (0.0, time), y, method="DOP853", rtol=1e-12,
        atol=1e-12,
    ).y[:, -1]  # fmt: skip
