"""Compiled quaternion arithmetic, for kernels on either side of the wall; see `lunarsim.frames`."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def rotation_between(q, target, out):
    """Write the rotation vector (body axes) from attitude q to `target`; return its length."""
    # conj(q) * target
    x = q[3] * target[0] - q[0] * target[3] - q[1] * target[2] + q[2] * target[1]
    y = q[3] * target[1] - q[1] * target[3] - q[2] * target[0] + q[0] * target[2]
    z = q[3] * target[2] - q[2] * target[3] - q[0] * target[1] + q[1] * target[0]
    w = q[3] * target[3] + q[0] * target[0] + q[1] * target[1] + q[2] * target[2]
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    s = np.sqrt(x * x + y * y + z * z)
    angle = 2.0 * np.arctan2(s, w)
    scale = angle / s if s > 1e-12 else 2.0
    out[0] = scale * x
    out[1] = scale * y
    out[2] = scale * z
    return angle


@kernel()
def turned(q, phi):
    """Turn the unit quaternion q by a rotation vector phi (body axes), in place."""
    angle = np.sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    s = 0.5 if angle < 1e-8 else np.sin(0.5 * angle) / angle
    x, y, z, w = phi[0] * s, phi[1] * s, phi[2] * s, np.cos(0.5 * angle)
    qx, qy, qz, qw = q[0], q[1], q[2], q[3]
    q[0] = qw * x + qx * w + qy * z - qz * y
    q[1] = qw * y - qx * z + qy * w + qz * x
    q[2] = qw * z + qx * y - qy * x + qz * w
    q[3] = qw * w - qx * x - qy * y - qz * z
    norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] /= norm


@kernel()
def rotated_back(q, v, out):
    """Write the ENU vector v in the body axes of the unit quaternion q."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    # v + 2 u x (u x v - w v), u being the vector part: the inverse rotation.
    cx = y * v[2] - z * v[1] - w * v[0]
    cy = z * v[0] - x * v[2] - w * v[1]
    cz = x * v[1] - y * v[0] - w * v[2]
    out[0] = v[0] + 2.0 * (y * cz - z * cy)
    out[1] = v[1] + 2.0 * (z * cx - x * cz)
    out[2] = v[2] + 2.0 * (x * cy - y * cx)


@kernel()
def points_along(position, rotation, direction, reach):
    """Return the points (n, 3) at distances (n,) from a position (3,) along rays.

    `direction` (n, 3) are the rays in axes from which `rotation` (3, 3) leads to those of the
    position.
    """
    out = np.empty(direction.shape)
    for i in range(len(direction)):
        x, y, z = direction[i, 0], direction[i, 1], direction[i, 2]
        for k in range(3):
            ray = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z
            out[i, k] = position[k] + reach[i] * ray
    return out


@kernel()
def along_thrust(direction, heading):
    """Return the quaternion whose body z is along `direction` and body x near `heading`."""
    z = direction / np.sqrt(np.sum(direction * direction))
    fx, fy = np.sin(heading), np.cos(heading)
    # z x forward; thrust along the heading: any roll will do.
    y = np.array([-z[2] * fy, z[2] * fx, z[0] * fy - z[1] * fx])
    size = np.sqrt(np.sum(y * y))
    if size < 1e-9:
        y = np.array([z[1], -z[0], 0.0])
        size = np.sqrt(np.sum(y * y))
    y /= size
    x = np.array([y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0]])
    m = np.stack((x, y, z), axis=1)
    # Shepperd's method: divide by the largest component.
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    k = 3
    best = trace
    for i in range(3):
        if m[i, i] > best:
            best, k = m[i, i], i
    q = np.empty(4)
    if k == 3:
        q[0], q[1], q[2] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
        q[3] = 1.0 + trace
    else:
        i, j, n = k, (k + 1) % 3, (k + 2) % 3
        q[i] = 1.0 - trace + 2.0 * m[i, i]
        q[j] = m[j, i] + m[i, j]
        q[n] = m[n, i] + m[i, n]
        q[3] = m[n, j] - m[j, n]
    return q / np.sqrt(np.sum(q * q))
