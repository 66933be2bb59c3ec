"""Angle between shadows and their expected direction: common functions."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.models.pinhole import View
from lunarsim.onboard.perception.detector import Detections
from lunarsim.typing import Array

Complex = NDArray[np.complex128]

# Prior scatter (rad) of the directions of single shadows, and the number of shadows that it is
# worth, because a few may agree by chance.
_PRIOR_SCATTER_RAD, PRIOR_NUMBER = float(np.deg2rad(25.0)), 4
# Window about a face, pixels, and the maximum relative brightness of a pixel in its mean.
_FACE_WINDOW_PX, _MAX_FACE_BRIGHTNESS = 7, 1.2


@dataclass(frozen=True)
class SunAngle:
    """Measured angle between shadows and their expected direction.

    Attributes
    ----------
    angle
        Angle on the terrain, rad, from -pi to pi; NaN if unknown.
    sigma
        Standard deviation of the angle from the scatter of the shadows, if the side is right, rad;
        infinite if unknown.
    side
        Significance of the side on which lit faces lie, in standard deviations of random
        directions; excludes an error of half a turn.
    number
        Number of rocks that determine the side.
    high_sun
        Whether the angle was measured under a high Sun, where it is less accurate for any number of
        rocks.
    by_faces
        Angle measured by lit faces, where `angle` is measured by the axes of patches, rad; NaN if
        unknown.
    """

    angle: float
    sigma: float
    side: float
    number: int
    high_sun: bool = False
    by_faces: float = float("nan")

    @property
    def agreement(self) -> float:
        """Agreement of the directions of single shadows (mean resultant length), up to 1.

        A small value means that most pairs of dark and bright areas are craters or slopes, not
        rocks.
        """
        spread = np.sqrt(0.5 * (self.number + PRIOR_NUMBER))
        return float(self.side * spread / self.number) if self.number else 0.0


def mean_angle(vectors: Complex) -> tuple[float, float]:
    """Return the angle of the mean of complex vectors (n,) and its error, rad.

    The error is the standard deviation. The results are NaN and infinite if there are fewer than
    three vectors, or if their mean is not significant.
    """
    n = len(vectors)
    if n < 3:
        return float("nan"), float("inf")
    mean = vectors.mean()
    length = abs(mean)
    across = np.imag(vectors * np.conj(mean) / max(length, 1e-12))
    usual = PRIOR_NUMBER * float((abs(vectors) ** 2).mean()) * np.sin(_PRIOR_SCATTER_RAD) ** 2
    spread = np.sqrt(((across**2).sum() + usual) / (n + PRIOR_NUMBER))
    if not length > 2.0 * spread / np.sqrt(n):
        return float("nan"), float("inf")
    return float(np.angle(mean)), float(spread / np.sqrt(n) / length)


def doubled_axes(length: Array, width: Array, skew: Array) -> Complex:
    """Return the axes of dark patches (n,) as complex vectors at twice their angle.

    Angles are measured from the Sun, counterclockwise from above. `length`, `width` (n,), m, and
    `skew` (n,), m^2, describe the patches as in `Detections`. The length of a vector is 0 for a
    round patch and 1 for a line.
    """
    along, across = length**2 / 12.0, width**2 / 12.0
    return np.asarray((along - across + 2j * skew) / np.maximum(along + across, 1e-12))


def local_relative_brightness(seen: Detections) -> NDArray[np.float32]:
    """Return the brightness of an image relative to lit pixels nearby (height, width).

    Pixels within a window of 7 pixels count that are in no dark patch. Unlike the face of a rock,
    a slope is no brighter than its surroundings.
    """
    lit = (seen.labels == 0).astype(np.float32)
    side, few = (_FACE_WINDOW_PX, _FACE_WINDOW_PX), np.float32(0.02)
    total = cv2.blur(cv2.multiply(cv2.min(seen.relative, _MAX_FACE_BRIGHTNESS), lit), side)
    return np.asarray(cv2.divide(seen.relative, (total + few) / (cv2.blur(lit, side) + few)))


def viewing_angles(view: View, points: Array, sun: Array) -> tuple[Array, Array]:
    """Return the camera's azimuth from the Sun and the depression at points, rad.

    Both are (n,): the azimuth of the camera, seen from the point, minus that of the Sun, clockwise
    from above; and the angle of the line of sight below the horizon. `points` (n, 3) are on the
    terrain, m, and `sun` (3,) is the direction towards the Sun.
    """
    line_of_sight = points - view.position
    azimuth = np.arctan2(-line_of_sight[:, 0], -line_of_sight[:, 1]) - np.arctan2(sun[0], sun[1])
    return azimuth, np.arctan2(
        -line_of_sight[:, 2], np.hypot(line_of_sight[:, 0], line_of_sight[:, 1])
    )
