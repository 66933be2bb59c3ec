"""Convert image errors to errors on the terrain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation.matrix_2x2 import invert_2x2, largest_eigenvalue_2x2
from lunarsim.onboard.navigation.rock_filter import RockFilter

Array = NDArray[np.float64]


def terrain_position_covariance(
    points: Array, pixel_covariance: Array, rocks: RockFilter, camera: CameraModel
) -> Array:
    """Return pixel covariances (n, 2, 2) as covariances at terrain points (n, 3), m^2."""
    if len(points) == 0:
        return np.empty((0, 2, 2))
    back = invert_2x2(rocks.sight(camera, points).by_rock[:, :, :2])
    return np.asarray(back @ pixel_covariance @ np.swapaxes(back, 1, 2))


def terrain_position_sigma(
    points: Array, look: Array, rocks: RockFilter, camera: CameraModel
) -> Array:
    """Return the error at points (n, 3), 1 sigma along the worst axis (n,), m.

    NaN where a point is not visible.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.sqrt(
                largest_eigenvalue_2x2(terrain_position_covariance(points, look, rocks, camera))
            )
        )
