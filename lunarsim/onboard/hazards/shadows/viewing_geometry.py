"""Viewing geometry of rocks on a plane, for shadow tables of horizontal terrain."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.typing import Array

# Minimum height of the camera above the terrain, m.
_MIN_HEIGHT_M = 1e-3


def viewing_geometry(
    xyz: Array, camera_position: Array, focal: float, sun: Array, plane: GroundPlane
) -> tuple[Array, Array, Array]:
    """Return the camera's azimuth from the Sun, depression and pixel size at rocks.

    Angles (...) are in rad and pixel sizes (...) in m. On a slope they are the values at which
    horizontal terrain would look the same.

    Parameters
    ----------
    xyz
        Positions of the rocks (..., 3), m.
    camera_position, focal
        Position of the camera (3,), m, and focal length, pixels.
    sun
        Direction towards the Sun (3,), ENU.
    plane
        Plane of the terrain.
    """
    to_camera = camera_position - xyz
    to_camera[..., 2] = np.maximum(to_camera[..., 2], _MIN_HEIGHT_M)
    horizontal = np.hypot(to_camera[..., 0], to_camera[..., 1])
    azimuth = np.arctan2(to_camera[..., 0], to_camera[..., 1]) - np.arctan2(sun[0], sun[1])
    pixel = np.hypot(horizontal, to_camera[..., 2]) / focal
    if plane.is_horizontal:
        return azimuth, np.arctan2(to_camera[..., 2], horizontal), pixel
    levelled_to_camera = plane.level_vectors(to_camera)
    levelled_to_camera[..., 2] = np.maximum(levelled_to_camera[..., 2], _MIN_HEIGHT_M)
    return (
        azimuth,
        np.arctan2(levelled_to_camera[..., 2], horizontal),
        plane.equivalent_pixel(pixel, to_camera, levelled_to_camera),
    )
