"""Camera geometry known to plant and onboard computer: pixels, optics and mount."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np

from lunarsim.errors import InputError, check_types
from lunarsim.frames import quat_to_matrix
from lunarsim.models.pinhole import Pinhole, View
from lunarsim.models.pose import Pose
from lunarsim.typing import Array

# Number of test points per image side, and maximum error (pixels) of the inverse distortion.
_TEST_POINTS_PER_SIDE, _MAX_INVERSION_ERROR_PX = 17, 0.5
# Body z points up through the lander: the camera points straight down, its x along body -y.
DOWNWARD_MOUNT = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class CameraModel:
    """Geometry of a framing camera on a lander.

    Attributes
    ----------
    width, height
        Size of the image, pixels.
    fx, fy
        Focal lengths, pixels.
    cx, cy
        Principal point, pixels, from the centre of the first pixel; None: centre of the image.
    distortion
        Brown-Conrady coefficients k1, k2, p1, p2, k3 in the order of OpenCV.
    offset
        Position in the body frame (3,), m.
    mount
        Rotation (3, 3), sensor to body; omitted: straight down, image up along body x.
    """

    width: int = 640
    height: int = 480
    fx: float = 554.3
    fy: float = 554.3
    cx: float | None = None
    cy: float | None = None
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount: Array = field(default_factory=DOWNWARD_MOUNT.copy)

    def __post_init__(self) -> None:
        check_types("camera", self)
        for name in ("width", "height"):
            if getattr(self, name) < 1:
                raise InputError(f"camera.{name}", getattr(self, name), "must be 1 or more")
        for name in ("fx", "fy"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(
                    f"camera.{name}", getattr(self, name), "must be positive and finite"
                )
        mount = np.asarray(self.mount, dtype=np.float64)
        proper = mount.shape == (3, 3) and np.allclose(mount @ mount.T, np.eye(3), atol=1e-6)
        if not (proper and np.linalg.det(mount) > 0.0):
            raise InputError(
                "camera.mount",
                np.array(self.mount).tolist(),
                "must be a rotation matrix of shape (3, 3)",
                show_value=False,
            )
        for name, middle in (("cx", 0.5 * (self.width - 1)), ("cy", 0.5 * (self.height - 1))):
            if getattr(self, name) is None:
                object.__setattr__(self, name, middle)
            elif not np.isfinite(getattr(self, name)):
                raise InputError(f"camera.{name}", getattr(self, name), "must be finite")
        for name, number in (("distortion", 5), ("offset", 3)):
            value = getattr(self, name)
            if len(value) != number or not np.isfinite(value).all():
                raise InputError(f"camera.{name}", value, f"must be {number} finite numbers")
        self._check_distortion()

    def _check_distortion(self) -> None:
        """Raise InputError if the lens distortion cannot be inverted over the image."""
        if not any(self.distortion):
            return
        u, v = np.meshgrid(
            np.linspace(0.0, self.width - 1.0, _TEST_POINTS_PER_SIDE),
            np.linspace(0.0, self.height - 1.0, _TEST_POINTS_PER_SIDE),
        )
        pixels = np.stack((u, v), -1).reshape(-1, 2)
        ideal = _undistort(pixels, self.pinhole, tuple(self.distortion))
        back, _ = cv2.projectPoints(
            np.column_stack((ideal, np.ones(len(ideal)))), np.zeros(3), np.zeros(3),
            self.pinhole.matrix, np.array(self.distortion),
        )  # fmt: skip
        error = np.hypot(*(back.reshape(-1, 2) - pixels).T)
        if not (error <= _MAX_INVERSION_ERROR_PX).all():
            raise InputError(
                "camera.distortion", tuple(self.distortion),
                "must be invertible over the complete image",
                "Use weaker distortion or a narrower field of view.",
            )  # fmt: skip

    @property
    def pinhole(self) -> Pinhole:
        """Pinhole projection without distortion."""
        assert self.cx is not None
        assert self.cy is not None
        return Pinhole(self.fx, self.fy, self.cx, self.cy)

    def view(self, pose: Pose) -> View:
        """Return the undistorted pinhole view of the camera at a lander pose."""
        rotation = quat_to_matrix(pose.attitude)
        position = pose.position + rotation @ np.asarray(self.offset)
        return View(position, rotation @ self.mount, *self.pinhole, self.width, self.height)

    @property
    def tangents(self) -> tuple[Array, Array]:
        """Tangents of each pixel's line of sight, right and down, (height, width) each.

        Lens distortion is removed.
        """
        return _tangents(self.width, self.height, self.pinhole, tuple(self.distortion))


def _undistort(pixels: Array, pinhole: Pinhole, distortion: tuple[float, ...]) -> Array:
    """Return the line-of-sight tangents (n, 2) of distorted pixels (n, 2).

    `distortion` are the Brown-Conrady coefficients k1, k2, p1, p2, k3.
    """
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    ideal = cv2.undistortPoints(
        pixels[:, None], pinhole.matrix, np.array(distortion), criteria=criteria
    )
    return np.asarray(ideal.reshape(-1, 2))


# A gimballed camera has a new object per image, so this costly result is cached per geometry.
@lru_cache(maxsize=8)
def _tangents(
    width: int, height: int, pinhole: Pinhole, distortion: tuple[float, ...]
) -> tuple[Array, Array]:
    """Return the tangents of each pixel's line of sight, right and down, cached.

    Lens distortion is removed; each result is (height, width).
    """
    if not any(distortion):
        return pinhole.tangents(width, height)
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    pixels = np.stack((u, v), axis=-1).reshape(-1, 2)
    ideal = _undistort(pixels, pinhole, distortion).reshape(height, width, 2)
    return np.ascontiguousarray(ideal[..., 0]), np.ascontiguousarray(ideal[..., 1])
