"""How rocks on a plane are seen: by which tables of shadows on level ground they are read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.perception.ground_plane import GroundPlane

Array = NDArray[np.float64]

# Cameras are above the ground by this at least, m.
_ABOVE = 1e-3


def aspect(
    xyz: Array, eye: Array, focal: float, sun: Array, plane: GroundPlane
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
    away = eye - xyz
    away[..., 2] = np.maximum(away[..., 2], _ABOVE)
    level = np.hypot(away[..., 0], away[..., 1])
    azimuth = np.arctan2(away[..., 0], away[..., 1]) - np.arctan2(sun[0], sun[1])
    pixel = np.hypot(level, away[..., 2]) / focal
    if plane.level:
        return azimuth, np.arctan2(away[..., 2], level), pixel
    above = plane.levelled(away)
    above[..., 2] = np.maximum(above[..., 2], _ABOVE)
    return azimuth, np.arctan2(above[..., 2], level), plane.seen_pixel(pixel, away, above)
