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
