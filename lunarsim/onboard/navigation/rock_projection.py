"""Predict the pixels of rocks in a camera image (shadow EKF paper, Eqs. 10-11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.frames import quat_to_matrix
from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.typing import Array


@dataclass(frozen=True)
class RockProjection:
    """Predicted pixels of rocks and their Jacobians.

    Attributes
    ----------
    pixel
        Predicted pixels (n, 2), without distortion (shadow EKF paper, Eq. 10).
    depth
        Distance along the boresight (n,), m; not positive behind the camera.
    jacobian_by_pose
        Derivatives with respect to the errors of the lander's position and attitude (n, 2, 6),
        pixels/m and pixels/rad; the attitude error is a small rotation in body axes.
    jacobian_by_rock
        Derivatives with respect to the rock's east, north and height (n, 2, 3), pixels/m.
    """

    pixel: Array
    depth: Array
    jacobian_by_pose: Array
    jacobian_by_rock: Array


def project_points(inertial: StrapdownState, camera: CameraModel, points: Array) -> RockProjection:
    """Predict the pixels of points (n, 3), m, with Jacobians, from the estimated pose.

    This is the projection of the shadow EKF paper (Eqs. 10-11).
    """
    rotation = quat_to_matrix(inertial.attitude)
    body = (points - inertial.position) @ rotation
    in_camera = (body - np.asarray(camera.offset)) @ camera.mount
    with np.errstate(divide="ignore", invalid="ignore"):
        pixel = camera.pinhole.project(in_camera)
        by_camera = camera.pinhole.jacobian(in_camera)
    by_body = by_camera @ camera.mount.T
    by_point = by_body @ rotation.T
    # d(body) = [body x] d(attitude); (row @ [body x])_k = (row x body)_k.
    by_attitude = np.empty_like(by_body)
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        by_attitude[..., k] = (
            by_body[..., a] * body[:, None, b] - by_body[..., b] * body[:, None, a]
        )
    by_pose = np.concatenate((-by_point, by_attitude), axis=-1)
    return RockProjection(pixel, in_camera[:, 2], by_pose, by_point)
