"""Reference frames and quaternions: conventions and conversions.

ENU
    Local Cartesian frame fixed to the terrain: x east, y north, z up, metres. Its origin is the
    centre of the terrain at the terrain's mean elevation. Gravity is ``(0, 0, -g)``.
Local and site
    Two ENU frames. The onboard computer keeps its maps, sites and state estimate in the `local`
    frame; maps in it do not move. The target and prior maps use the `site` frame. Navigation
    estimates the site frame relative to the local frame (`SiteToLocal`). An error of this estimate
    affects lander and map equally.
Body
    Fixed to the lander, origin at the centre of mass, z along the thrust (up through the
    vehicle when it stands), x forward, y left.
Sensor
    z along the boresight, x right, y down, as image coordinates run.
Quaternion
    Scalar last ``(x, y, z, w)``, rotates body vectors into ENU, as in `scipy.spatial.transform`.
    ``q`` and ``-q`` are the same attitude; functions may return either.
Angles
    Radians in code. Degrees only in scenario keys and printed values whose names end in ``_deg``.
    Azimuth is clockwise from north, elevation is upward from the horizon.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from lunarsim._frame_kernels import thrust_attitude
from lunarsim.typing import Array


def rotation_about_up(angle: float) -> Array:
    """Return the matrix (3, 3) of a counterclockwise rotation about the up axis.

    `angle` is in rad.

    Examples
    --------
    >>> np.round(rotation_about_up(np.pi / 2) @ [1.0, 0.0, 0.0], 6)
    array([0., 1., 0.])
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class SiteToLocal:
    """Transform between the site frame and the local frame, which share the up axis.

    Attributes
    ----------
    offset
        Origin of the site frame in local coordinates (3,), m.
    turn
        Counterclockwise angle about up, rad, from the local axes to the site axes. A positive angle
        turns the site's east axis towards the local north axis.

    Examples
    --------
    >>> shift = SiteToLocal(np.array([10.0, -5.0, 1.0]))
    >>> shift.to_local([[0.0, 0.0, 0.0]])
    array([[10., -5.,  1.]])
    >>> shift.to_site(shift.to_local([[3.0, 4.0, 5.0]]))
    array([[3., 4., 5.]])
    """

    offset: Array = field(default_factory=lambda: np.zeros(3))
    turn: float = 0.0

    def to_local(self, points: ArrayLike) -> Array:
        """Transform points (..., 3) from the site frame to the local frame, m."""
        given = np.asarray(points, dtype=np.float64)
        if self.turn:
            given = given @ rotation_about_up(self.turn).T
        return np.asarray(given + self.offset)

    def to_site(self, points: ArrayLike) -> Array:
        """Transform points (..., 3) from the local frame to the site frame, m."""
        out = np.asarray(points, dtype=np.float64) - self.offset
        return np.asarray(out @ rotation_about_up(self.turn)) if self.turn else out


def normalised(v: ArrayLike) -> Array:
    """Return vectors `v` (..., n) scaled to unit length along the last axis.

    Raises
    ------
    ValueError
        If a vector has zero length.

    Examples
    --------
    >>> normalised([3.0, 0.0, 4.0])
    array([0.6, 0. , 0.8])
    """
    v = np.asarray(v, dtype=np.float64)
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    if np.any(length == 0.0):
        raise ValueError("a vector of zero length cannot be normalised")
    return np.asarray(v / length)


def angle_between(a: Array, b: Array) -> float:
    """Return the angle between two vectors (3,), rad; also exact for small angles."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def is_rotation(q: ArrayLike) -> bool:
    """Return whether `q` is a quaternion (4,) with a norm of 1, to within 0.001.

    Examples
    --------
    >>> is_rotation([0.0, 0.0, 0.0, 1.0]), is_rotation([0.0, 0.0, 0.0, 2.0])
    (True, False)
    """
    numbers = _numbers(q, 4)
    return bool(numbers is not None and abs(np.linalg.norm(numbers) - 1.0) <= 1e-3)


def is_position(position: ArrayLike) -> bool:
    """Return whether a value consists of three finite numbers.

    Examples
    --------
    >>> is_position([0.0, 1.0, 2.0]), is_position([0.0, 1.0]), is_position(None)
    (True, False, False)
    """
    return _numbers(position, 3) is not None


def _numbers(values: ArrayLike, count: int) -> Array | None:
    """Return values as an array (count,) if all are finite numbers, otherwise None."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array if array.shape == (count,) and np.isfinite(array).all() else None


def quat_multiply(p: ArrayLike, q: ArrayLike) -> Array:
    """Return the quaternion product ``p q`` (..., 4): rotation by q, then by p.

    Examples
    --------
    >>> half = quat_from_rotation_vector([0.0, 0.0, np.pi / 4])
    >>> np.round(quat_multiply(half, half), 4)
    array([0.    , 0.    , 0.7071, 0.7071])
    """
    p = np.asarray(p, dtype=np.float64)
    q = np.asarray(q, dtype=np.float64)
    # Fast path: onboard software multiplies single quaternions thousands of times per second.
    one = p.shape == q.shape == (4,)
    px, py, pz, pw = p.tolist() if one else np.moveaxis(p, -1, 0)
    qx, qy, qz, qw = q.tolist() if one else np.moveaxis(q, -1, 0)
    parts = (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )
    return np.array(parts) if one else np.stack(parts, axis=-1)


def quat_conjugate(q: ArrayLike) -> Array:
    """Return the inverse rotation of the unit quaternion `q` (..., 4)."""
    return np.asarray(np.asarray(q, dtype=np.float64) * np.array([-1.0, -1.0, -1.0, 1.0]))


def quat_to_matrix(q: ArrayLike) -> Array:
    """Return rotation matrices (..., 3, 3), body to ENU, from quaternions (..., 4).

    The quaternions must have unit length.

    Examples
    --------
    >>> quat_to_matrix([0.0, 0.0, 0.0, 1.0])
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    q = np.asarray(q, dtype=np.float64)
    one = q.shape == (4,)
    x, y, z, w = q.tolist() if one else np.moveaxis(q, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.array(rows) if one else np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Rotate body vectors `v` (..., 3) into ENU by unit quaternions `q` (..., 4).

    Examples
    --------
    >>> quarter = quat_from_rotation_vector([0.0, 0.0, np.pi / 2])  # about up
    >>> np.round(quat_rotate(quarter, [1.0, 0.0, 0.0]), 6)
    array([0., 1., 0.])
    """
    rotation = quat_to_matrix(q)
    return np.asarray(np.einsum("...ij,...j->...i", rotation, np.asarray(v, dtype=np.float64)))


def quat_from_rotation_vector(phi: ArrayLike) -> Array:
    """Return unit quaternions (..., 4) from rotation vectors (..., 3), rad.

    Examples
    --------
    >>> quat_from_rotation_vector([0.0, 0.0, 0.0])
    array([0., 0., 0., 1.])
    """
    phi = np.asarray(phi, dtype=np.float64)
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    # `sinc` gives the exact limit at small angles.
    vector = 0.5 * phi * np.sinc(angle / (2.0 * np.pi))
    return np.concatenate((vector, np.cos(0.5 * angle)), axis=-1)


def quat_to_rotation_vector(q: ArrayLike) -> Array:
    """Return the shortest rotation vectors (..., 3), rad, from quaternions (..., 4).

    The quaternions must have unit length.

    Examples
    --------
    >>> quat_to_rotation_vector(quat_from_rotation_vector([0.1, 0.2, 0.3]))
    array([0.1, 0.2, 0.3])
    """
    q = np.asarray(q, dtype=np.float64)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    scale = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return np.asarray(q[..., :3] * scale)


def quat_angle(p: ArrayLike, q: ArrayLike) -> Array:
    """Return the angle (rad) between attitudes `p` and `q` (..., 4).

    Examples
    --------
    >>> turned = quat_from_rotation_vector([0.2, 0.0, 0.0])
    >>> round(float(quat_angle(turned, [0.0, 0.0, 0.0, 1.0])), 6)
    0.2
    """
    between = quat_multiply(quat_conjugate(p), q)
    return np.asarray(np.linalg.norm(quat_to_rotation_vector(between), axis=-1))


def attitude_from_thrust(direction: ArrayLike, heading: float) -> Array:
    """Return the attitude quaternion (4,) with body z along a thrust direction.

    Body x is as near as possible to the heading.

    Parameters
    ----------
    direction
        Thrust direction in ENU (3,), any non-zero length.
    heading
        Azimuth of body x, clockwise from north (rad).

    Raises
    ------
    ValueError
        If the direction has zero length.

    Examples
    --------
    >>> upright = attitude_from_thrust([0.0, 0.0, 1.0], heading=0.0)  # body x to the north
    >>> np.round(quat_rotate(upright, [1.0, 0.0, 0.0]), 6)
    array([0., 1., 0.])
    """
    vector = np.ascontiguousarray(direction, dtype=np.float64)
    if not vector.any():
        raise ValueError("the thrust direction must not have zero length")
    return np.asarray(thrust_attitude(vector, heading))


def matrix_to_quat(m: ArrayLike) -> Array:
    """Return the unit quaternion (4,) of a rotation matrix (3, 3), body to ENU."""
    m = np.asarray(m, dtype=np.float64)
    # Shepperd's method: divide by the largest component.
    diagonal = np.array([m[0, 0], m[1, 1], m[2, 2], np.trace(m)])
    k = int(np.argmax(diagonal))
    q = np.empty(4)
    if k == 3:
        q[:] = (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1.0 + diagonal[3])
    else:
        i, j, n = k, (k + 1) % 3, (k + 2) % 3
        q[i] = 1.0 - diagonal[3] + 2.0 * m[i, i]
        q[j] = m[j, i] + m[i, j]
        q[n] = m[n, i] + m[i, n]
        q[3] = m[n, j] - m[j, n]
    return normalised(q)


def heading_of(q: ArrayLike) -> float:
    """Return the azimuth of body x in the horizontal plane, rad, from an attitude.

    The azimuth is clockwise from north; `q` (4,) is the attitude, body to ENU.

    Examples
    --------
    >>> round(heading_of(attitude_from_thrust([0.0, 0.0, 1.0], 0.3)), 6)
    0.3
    """
    x = quat_rotate(q, [1.0, 0.0, 0.0])
    return float(np.arctan2(x[0], x[1]))


def direction_from_angles(azimuth: float, elevation: float) -> Array:
    """Return the ENU unit vector (3,) at an azimuth and an elevation angle (rad).

    Examples
    --------
    >>> np.round(direction_from_angles(np.pi / 2, 0.0), 6)  # in the east, on the horizon
    array([1., 0., 0.])
    """
    c = np.cos(elevation)
    return np.array([c * np.sin(azimuth), c * np.cos(azimuth), np.sin(elevation)])


def enu_axes(latitude: float, longitude: float) -> Array:
    """Return the unit vectors east, north and up of a place as columns (3, 3).

    Latitude and longitude, rad, and the vectors are those of the frame that is fixed to the Moon.
    """
    (c, s), (cl, sl) = ((np.cos(angle), np.sin(angle)) for angle in (latitude, longitude))
    return np.column_stack(((-sl, cl, 0.0), (-s * cl, -s * sl, c), (c * cl, c * sl, s)))


def sensor_axes(boresight: ArrayLike) -> Array:
    """Return the matrix (3, 3), sensor to ENU, for a boresight direction in ENU (3,).

    The sensor has no roll: its image x axis is horizontal. For a boresight straight down, x points
    east and y south.

    Examples
    --------
    >>> float(sensor_axes([0.0, 0.0, -1.0])[:, 2] @ [0.0, 0.0, -1.0])  # z along the boresight
    1.0
    """
    z = normalised(boresight)
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 1.0 - 1e-9 else np.array([0.0, 1.0, 0.0])
    x = normalised(np.cross(z, up))
    return np.column_stack((x, np.cross(z, x), z))
