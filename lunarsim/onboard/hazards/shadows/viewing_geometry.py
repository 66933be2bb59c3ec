"""How rocks on a plane are seen: by which tables of shadows on level ground they are read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.perception.ground_plane import GroundPlane

Array = NDArray[np.float64]

# Cameras are above the ground by this at least, m.
_MIN_HEIGHT_M = 1e-3


def viewing_geometry(
    xyz: Array, camera_position: Array, focal: float, sun: Array, plane: GroundPlane
) -> tuple[Array, Array, Array]:
    """Return azimuth of the camera from the Sun's, depression (rad) and pixel (m) of rocks (...).

    On a slope these are what level ground would have that shows the same.

    Parameters
    ----------
    xyz
        Where rocks stand (..., 3), m.
    eye, focal
        Place of the camera (3,), m, and its focal length, pixels.
    sun
        Direction towards it (3,), ENU.
    plane
        Of the ground.
    """
    to_camera = camera_position - xyz
    to_camera[..., 2] = np.maximum(to_camera[..., 2], _MIN_HEIGHT_M)
    horizontal = np.hypot(to_camera[..., 0], to_camera[..., 1])
    azimuth = np.arctan2(to_camera[..., 0], to_camera[..., 1]) - np.arctan2(sun[0], sun[1])
    pixel = np.hypot(horizontal, to_camera[..., 2]) / focal
    if plane.level:
        return azimuth, np.arctan2(to_camera[..., 2], horizontal), pixel
    levelled_to_camera = plane.levelled(to_camera)
    levelled_to_camera[..., 2] = np.maximum(levelled_to_camera[..., 2], _MIN_HEIGHT_M)
    return (
        azimuth,
        np.arctan2(levelled_to_camera[..., 2], horizontal),
        plane.seen_pixel(pixel, to_camera, levelled_to_camera),
    )
