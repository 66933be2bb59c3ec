"""Pointing of a gimballed sensor within its limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.frames import (
    normalised,
    quat_from_rotation_vector,
    quat_to_matrix,
    sensor_axes,
)
from lunarsim.typing import Array

_REST_BORESIGHT = np.array([0.0, 0.0, -1.0])


def gimbal_mount(attitude: ArrayLike, boresight: ArrayLike, limit: float = np.pi) -> Array:
    """Return the gimbal rotation that points a sensor in a direction.

    Parameters
    ----------
    attitude
        Quaternion (4,), body to ENU, that the gimbal control uses.
    boresight
        Desired direction (3,), ENU.
    limit
        Maximum angle of the boresight from body -z, rad. Beyond it the sensor stops at the limit,
        on the side of the desired direction.

    Returns
    -------
    Array
        Rotation (3, 3), sensor to body.
    """
    rotation = quat_to_matrix(attitude)
    desired = rotation.T @ normalised(boresight)
    if desired @ _REST_BORESIGHT < np.cos(limit):
        lateral = desired - (desired @ _REST_BORESIGHT) * _REST_BORESIGHT
        length = np.linalg.norm(lateral)
        lateral = lateral / length if length > 1e-12 else np.array([1.0, 0.0, 0.0])
        desired = np.cos(limit) * _REST_BORESIGHT + np.sin(limit) * lateral
        return np.asarray(rotation.T @ sensor_axes(rotation @ desired))
    return np.asarray(rotation.T @ sensor_axes(boresight))


def limit_mount(mount: Array, limit: float) -> Array:
    """Limit the boresight angle of a gimbal rotation; return the limited rotation.

    `mount` (3, 3) is the rotation, sensor to body; `limit` is the maximum angle of the boresight
    from body -z, rad.
    """
    boresight = mount[:, 2]
    if boresight @ _REST_BORESIGHT >= np.cos(limit) - 1e-9:
        return mount
    axis_vector = np.cross(boresight, _REST_BORESIGHT)
    length = np.linalg.norm(axis_vector)
    # If the boresight points straight up, every direction is equally near.
    axis = axis_vector / length if length > 1e-12 else np.array([1.0, 0.0, 0.0])
    excess = np.arccos(np.clip(boresight @ _REST_BORESIGHT, -1.0, 1.0)) - limit
    return np.asarray(quat_to_matrix(quat_from_rotation_vector(axis * excess)) @ mount)
