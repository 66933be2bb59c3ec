"""By what angle shadows fall beside where a Sun would throw them: what measurements of it share."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.models.pinhole import View
from lunarsim.onboard.perception.detector import Detections

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Directions of single shadows scatter by what is found as if so many more had been seen to scatter
# by so much, rad: few may agree by chance.
_PRIOR_SCATTER_RAD, PRIOR_NUMBER = float(np.deg2rad(25.0)), 4
# A face is brighter than what is lit within so many pixels, of which none counts as brighter than
# this.
_FACE_WINDOW_PX, _MAX_FACE_BRIGHTNESS = 7, 1.2


@dataclass(frozen=True)
class SunAngle:
    """By what angle shadows fall beside where the Sun should throw them.

    Attributes
    ----------
    angle
        On the ground, rad, from -pi to pi; NaN if nothing tells.
    sigma
        Standard deviation of what chance makes of it, were its side certain; infinite if nothing
        tells.
    side
        By how many standard deviations of chance lit faces lie on this side of the shadows and
        not on the other: what tells an angle from one that is half a turn more.
    number
        Of rocks by which the side is told.
    high_sun
        Whether it was told under a high Sun, where it is known less well however many rocks tell.
    by_faces
        What lit faces say of the angle where the axes of shadows tell it, rad; NaN: too little.
    """

    angle: float
    sigma: float
    side: float
    number: int
    high_sun: bool = False
    by_faces: float = float("nan")

    @property
    def agreement(self) -> float:
        """How alike the directions of single shadows are: the length of their mean, up to 1.

        Where it is short, most of what is dark and bright side by side is no rock with its shadow:
        craters, or slopes.
        """
        spread = np.sqrt(0.5 * (self.number + PRIOR_NUMBER))
        return float(self.side * spread / self.number) if self.number else 0.0


def mean_angle(vectors: Complex) -> tuple[float, float]:
    """Return the angle of the mean of vectors (n,) and its standard deviation, rad.

    Not known, NaN and infinite, where the mean is no longer than chance makes it.
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
    """Return the axes of patches (n,) as vectors at twice their angle from the Sun's azimuth.

    Their length is 0 for round patches, 1 for lines.
    """
    along, across = length**2 / 12.0, width**2 / 12.0
    return np.asarray((along - across + 2j * skew) / np.maximum(along + across, 1e-12))


def local_relative_brightness(seen: Detections) -> NDArray[np.float32]:
    """Return brightness over that of what is lit within a few pixels (height, width).

    A slope is no brighter than its surroundings; the face of a rock is.
    """
    lit = (seen.labels == 0).astype(np.float32)
    side, few = (_FACE_WINDOW_PX, _FACE_WINDOW_PX), np.float32(0.02)
    total = cv2.blur(cv2.multiply(cv2.min(seen.relative, _MAX_FACE_BRIGHTNESS), lit), side)
    return np.asarray(cv2.divide(seen.relative, (total + few) / (cv2.blur(lit, side) + few)))


def viewing_angles(view: View, points: Array, sun: Array) -> tuple[Array, Array]:
    """Return azimuth of the camera from the Sun's and depression of the sight of points (n, 3)."""
    line_of_sight = points - view.position
    azimuth = np.arctan2(-line_of_sight[:, 0], -line_of_sight[:, 1]) - np.arctan2(sun[0], sun[1])
    return azimuth, np.arctan2(
        -line_of_sight[:, 2], np.hypot(line_of_sight[:, 0], line_of_sight[:, 1])
    )
