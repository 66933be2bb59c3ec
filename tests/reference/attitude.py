"""Slow, plain attitudes and inertial samples, by SciPy's rotations."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation


def along_thrust(direction, heading):
    """Return the quaternion with body z along `direction`, body x as near the heading as it can."""
    z = np.asarray(direction) / np.linalg.norm(direction)
    forward = np.array([np.sin(heading), np.cos(heading), 0.0])
    x = forward - (forward @ z) * z
    x /= np.linalg.norm(x)
    return Rotation.from_matrix(np.column_stack((x, np.cross(z, x), z))).as_quat()


def rotation_between(p, q):
    """Return the rotation vector, axes of p, from attitude p to q."""
    return (Rotation.from_quat(p).inv() * Rotation.from_quat(q)).as_rotvec()


def ideal_samples(rows, lift):
    """Return angle and velocity increments (n, 3) of a perfect inertial unit."""
    angle, gained = [], []
    for before, after in pairwise(rows):
        turn = rotation_between(before[6:10], after[6:10])
        middle = Rotation.from_quat(before[6:10]) * Rotation.from_rotvec(0.5 * turn)
        angle.append(turn)
        gained.append(middle.inv().apply(after[3:6] - before[3:6] + [0.0, 0.0, lift]))
    return np.array(angle), np.array(gained)


def triad(truth, matrix, offsets, quantum):
    """Return the increments of a triad whose running sum is rounded to whole quanta."""
    wanted = np.cumsum(truth @ matrix.T + offsets, axis=0)
    if quantum == 0.0:
        return np.diff(wanted, axis=0, prepend=np.zeros((1, 3)))
    whole = quantum * np.rint(wanted / quantum)
    return np.diff(whole, axis=0, prepend=np.zeros((1, 3)))
