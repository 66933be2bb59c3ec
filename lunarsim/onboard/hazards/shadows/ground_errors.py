"""Errors in the picture as errors on the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation.planar import inverse, largest_eigenvalue
from lunarsim.onboard.navigation.rock_filter import RockFilter

Array = NDArray[np.float64]


def ground_covariance(
    points: Array, pixel_covariance: Array, rocks: RockFilter, camera: CameraModel
) -> Array:
    """Return covariances of pixels (n, 2, 2) at points (n, 3) of the ground (n, 2, 2), m^2."""
    if len(points) == 0:
        return np.empty((0, 2, 2))
    back = inverse(rocks.sight(camera, points).by_rock[:, :, :2])
    return np.asarray(back @ pixel_covariance @ np.swapaxes(back, 1, 2))


def ground_spread(points: Array, look: Array, rocks: RockFilter, camera: CameraModel) -> Array:
    """Return how well looks show points (n, 3), 1 sigma along the worse way (n,), m; NaN: not."""
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.sqrt(largest_eigenvalue(ground_covariance(points, look, rocks, camera)))
        )
