"""Test whether an image is dark where the shadow of a rock is expected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.shadow_model import ShadowPatch

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def is_dark_at_patch(
    rocks: RockFilter,
    index: Index,
    unit: ShadowPatch,
    seen: Detections,
    camera: CameraModel,
    sun: Array,
    plane: GroundPlane,
) -> NDArray[np.bool_]:
    """Return whether an image is dark where the shadow of each rock is expected (n,).

    Parameters
    ----------
    rocks, index
        Filter of the tracked rocks, and the indices of the rocks to test (n,).
    unit
        Expected dark patches for rocks of radius 1 at these positions.
    seen, camera
        Detections in the image, and the camera model.
    sun, plane
        Direction towards the Sun (3,), ENU, and the plane on which shadows fall.
    """
    s = np.array([sun[0], sun[1]]) / np.hypot(sun[0], sun[1])
    offset = np.stack((unit.along, unit.side), -1) @ np.array([[s[0], s[1]], [-s[1], s[0]]])
    middle = rocks.xyz[index]
    offset *= rocks.radius[index, None]
    middle += np.column_stack((offset, offset @ np.array(plane.gradient)))
    u, v = np.rint(rocks.project_rocks(camera, middle).pixel).T
    u = np.clip(u, 0, camera.width - 1).astype(int)
    v = np.clip(v, 0, camera.height - 1).astype(int)
    return np.asarray(seen.labels[v, u] > 0)
