# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled quaternion arithmetic.

Quaternions are scalar last, body to ENU; `lunarsim.frames` has the conventions.
"""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel


@kernel()
def rotation_vector_between(q, target, out):
    """Write the rotation vector from attitude `q` to attitude `target` into `out`.

    The rotation vector (3,) is in body axes, rad; the function returns its angle. Both attitudes
    are unit quaternions (4,).
    """
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
def rotate_quaternion(q, phi):
    """Rotate the attitude quaternion `q` (4,) in place by a rotation vector.

    `q` is scalar last, body to ENU, of unit length. `phi` (3,) is the rotation vector in body axes,
    rad: the result is q times the quaternion of `phi`.
    """
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
def rotate_to_body(q, v, out):
    """Write the ENU vector v (3,) in body axes into `out` (3,).

    `q` is the attitude, a unit quaternion (4,), body to ENU.
    """
    x, y, z, w = q[0], q[1], q[2], q[3]
    # Inverse rotation: v + 2 u x (u x v - w v), where u is the vector part.
    cx = y * v[2] - z * v[1] - w * v[0]
    cy = z * v[0] - x * v[2] - w * v[1]
    cz = x * v[1] - y * v[0] - w * v[2]
    out[0] = v[0] + 2.0 * (y * cz - z * cy)
    out[1] = v[1] + 2.0 * (z * cx - x * cz)
    out[2] = v[2] + 2.0 * (x * cy - y * cx)


@kernel()
def ray_points(origin, rotation, directions, distances):
    """Return the points (n, 3) at `distances` (n,) along rays from an origin (3,), m.

    `directions` (n, 3) are unit vectors in sensor axes; `rotation` (3, 3) rotates them into the
    frame of origin and points.
    """
    out = np.empty(directions.shape)
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        for k in range(3):
            ray = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z
            out[i, k] = origin[k] + distances[i] * ray
    return out


@kernel()
def thrust_attitude(direction, heading):
    """Return the attitude quaternion (4,) with body z along a thrust direction.

    `direction` (3,) is in ENU; body x is as near as possible to the azimuth `heading`, rad.
    """
    q = np.empty(4)
    write_thrust_attitude(direction[0], direction[1], direction[2], heading, q)
    return q


@kernel(allocates=False)
def write_thrust_attitude(east, north, up, heading, q):
    """Write the attitude quaternion `q` (4,) with body z along a thrust direction.

    The thrust direction is (east, north, up), of any length; body x is as near as possible to the
    azimuth `heading`, rad.
    """
    size = np.sqrt(east * east + north * north + up * up)
    zx, zy, zz = east / size, north / size, up / size
    fx, fy = np.sin(heading), np.cos(heading)
    # y = z x forward. If the thrust is along the heading, any roll angle is valid.
    yx, yy, yz = -zz * fy, zz * fx, zx * fy - zy * fx
    size = np.sqrt(yx * yx + yy * yy + yz * yz)
    if size < 1e-9:
        yx, yy, yz = zy, -zx, 0.0
        size = np.sqrt(yx * yx + yy * yy)
    yx, yy, yz = yx / size, yy / size, yz / size
    xx, xy, xz = yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx
    # Shepperd's method: divide by the largest component.
    trace = xx + yy + zz
    if trace >= max(xx, yy, zz):
        q[0], q[1], q[2], q[3] = yz - zy, zx - xz, xy - yx, 1.0 + trace
    elif xx >= max(yy, zz):
        q[0], q[1], q[2], q[3] = 1.0 - trace + 2.0 * xx, xy + yx, zx + xz, yz - zy
    elif yy >= zz:
        q[1], q[2], q[0], q[3] = 1.0 - trace + 2.0 * yy, yz + zy, xy + yx, zx - xz
    else:
        q[2], q[0], q[1], q[3] = 1.0 - trace + 2.0 * zz, zx + xz, yz + zy, xy - yx
    norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] /= norm
