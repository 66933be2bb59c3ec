"""Test whether an image is dark where the shadow of a rock is expected."""

from __future__ import annotations

import numpy as np

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.shadow_model import ShadowPatch
from lunarsim.typing import Array, BoolArray, IntArray


def is_dark_at_patch(
    rocks: RockFilter,
    index: IntArray,
    unit_patches: ShadowPatch,
    detections: Detections,
    camera: CameraModel,
    sun: Array,
    plane: GroundPlane,
) -> BoolArray:
    """Return whether an image is dark where the shadow of each rock is expected (n,).

    `rocks` is the filter of the tracked rocks and `index` (n,) selects the rocks. `unit_patches`
    are the expected dark patches of rocks of radius 1 m at their positions. `sun` (3,) is the
    direction towards the Sun, ENU, and `plane` the plane on which shadows fall.
    """
    s = np.array([sun[0], sun[1]]) / np.hypot(sun[0], sun[1])
    offset = np.stack((unit_patches.along, unit_patches.side), -1) @ np.array(
        [[s[0], s[1]], [-s[1], s[0]]]
    )
    middle = rocks.xyz[index]
    offset *= rocks.radius[index, None]
    middle += np.column_stack((offset, offset @ np.array(plane.gradient)))
    u, v = np.rint(rocks.project_rocks(camera, middle).pixel).T
    u = np.clip(u, 0, camera.width - 1).astype(int)
    v = np.clip(v, 0, camera.height - 1).astype(int)
    return np.asarray(detections.labels[v, u] > 0)
