"""Convert image errors to errors on the terrain."""

from __future__ import annotations

import numpy as np

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation.matrix_2x2 import invert_2x2, largest_eigenvalue_2x2
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.typing import Array


def terrain_position_covariance(
    points: Array, pixel_covariance: Array, rocks: RockFilter, camera: CameraModel
) -> Array:
    """Convert image covariances to covariances on the terrain (n, 2, 2), m^2.

    `points` (n, 3) are on the terrain, m, and `pixel_covariance` (n, 2, 2) is in pixels^2. The
    filter `rocks` contains the pose of the camera.
    """
    if len(points) == 0:
        return np.empty((0, 2, 2))
    back = invert_2x2(rocks.project_rocks(camera, points).jacobian_by_rock[:, :, :2])
    return np.asarray(back @ pixel_covariance @ np.swapaxes(back, 1, 2))


def terrain_position_sigma(
    points: Array, pixel_covariance: Array, rocks: RockFilter, camera: CameraModel
) -> Array:
    """Convert image covariances to position errors on the terrain (n,), 1 sigma, m.

    The error is that along the worst axis, and NaN where a point is not visible. The arguments are
    those of `terrain_position_covariance`.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.sqrt(
                largest_eigenvalue_2x2(
                    terrain_position_covariance(points, pixel_covariance, rocks, camera)
                )
            )
        )
