"""Plain update of rocks by measured ground: the Jacobian by differences, dense matrices."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def above(xyz, position, attitude, gradient, level, error, columns):
    """How far true ground lies above true rocks (n,), if all errs by `error` (size,).

    The ground was measured as a plane from where the lander took itself to be; it is carried along
    as the lander is found to be elsewhere, and turned.
    """
    estimated = Rotation.from_quat(attitude)
    true = estimated * Rotation.from_rotvec(error[9:12])
    here = position + error[:3]
    rocks = xyz + error[columns]
    # Three points of the plane under each rock, moved as what the lander measured is.
    out = np.empty(len(xyz))
    for k, rock in enumerate(xyz):
        corners = []
        for off in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
            xy = rock[:2] + off
            point = np.array([*xy, level + np.dot(gradient, xy)])
            corners.append(here + true.apply(estimated.inv().apply(point - position)))
        a, b, c = corners
        normal = np.cross(b - a, c - a)
        under = a[2] - (normal[:2] @ (rocks[k, :2] - a[:2])) / normal[2]
        out[k] = under - rocks[k, 2]
    return out


def jacobian(xyz, position, attitude, gradient, level, columns, size):
    """Derivatives by the errors of what measured ground is found to be above rocks (n, size).

    What is found is what makes the true ground and the true rocks meet: its sign is the opposite.
    """
    out = np.zeros((len(xyz), size))
    step = 1e-5
    for k in range(size):
        error = np.zeros(size)
        error[k] = step
        more = above(xyz, position, attitude, gradient, level, error, columns)
        less = above(xyz, position, attitude, gradient, level, -error, columns)
        out[:, k] = -(more - less) / (2.0 * step)
    return out


def laid(covariance, xyz, position, attitude, gradient, level, columns, own, common):
    """Error state (size,) that the update tells, and the covariance after it."""
    size = len(covariance)
    h = jacobian(xyz, position, attitude, gradient, level, columns, size)
    found = above(xyz, position, attitude, gradient, level, np.zeros(size), columns)
    noise = own**2 * np.eye(len(xyz)) + common**2
    gain = covariance @ h.T @ np.linalg.inv(h @ covariance @ h.T + noise)
    keep = np.eye(size) - gain @ h
    return gain @ found, keep @ covariance @ keep.T + gain @ noise @ gain.T
