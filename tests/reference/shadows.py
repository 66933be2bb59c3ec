"""Slow, plain counterparts of the shadow pipeline's kernels."""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad
from scipy.stats import ncx2, norm


def patch(labels, label, view, ground, sun):
    """Return mean along, mean across, length, width and size of a patch, pixel by pixel."""
    level = np.hypot(sun[0], sun[1])
    to_sun = np.array([sun[0], sun[1]]) / level
    to_left = np.array([-to_sun[1], to_sun[0]])
    points = []
    for i, j in np.argwhere(labels == label):
        ray = view.axes @ np.array([(j - view.cx) / view.fx, (i - view.cy) / view.fy, 1.0])
        t = (ground - view.position[2]) / ray[2]
        points.append((t * ray)[:2])
    points = np.array(points)
    along, across = points @ to_sun, points @ to_left
    return (
        along.mean(), across.mean(), np.sqrt(12.0) * along.std(), np.sqrt(12.0) * across.std(),
        len(points),
    )  # fmt: skip


def rice(d, sigma, mean, spread):
    """Return P(|centre - x| <= radius) by integrating Rice's distribution function."""

    def given(r):
        return ncx2.cdf((r / sigma) ** 2, 2, (d / sigma) ** 2) * norm.pdf(r, mean, spread)

    low, high = max(mean - 8.0 * spread, 0.0), mean + 8.0 * spread
    return quad(given, low, high, limit=400, points=[mean])[0]


def inertial(state, angle, velocity, step, gravity):
    """Return position, velocity and quaternion after samples, with SciPy's rotations."""
    from scipy.spatial.transform import Rotation

    r, v, turn = state[0:3].copy(), state[3:6].copy(), Rotation.from_quat(state[9:13])
    for k in range(len(angle)):
        w = angle[k] - step * state[13:16]
        dv = velocity[k] - step * state[6:9]
        middle = turn * Rotation.from_rotvec(0.5 * w)
        a = middle.apply(dv) / step + gravity
        r = r + step * (v + 0.5 * step * a)
        v = v + step * a
        turn = turn * Rotation.from_rotvec(w)
    return r, v, turn.as_quat()


def consider_update(p, h, r, states):
    """Return gain and covariance after a measurement that corrects `states` alone (Joseph's form).

    `h` (m, n) and `r` (m, m) are the measurement's Jacobian and covariance.
    """
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
    left = np.ones(len(p), bool)
    left[states] = False
    gain[left] = 0.0
    keep = np.eye(len(p)) - gain @ h
    return gain, keep @ p @ keep.T + gain @ r @ gain.T
