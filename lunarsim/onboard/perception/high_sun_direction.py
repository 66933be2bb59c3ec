"""Angle of shadows under a high Sun, from the positions of black and grey pixels.

See `lunarsim.onboard.perception.lit_faces`. The shape of rocks matters: from the side, faces
towards the camera shift the grey of cubes 30 deg farther than that of low rocks. The axes of
patches, which give little information by themselves, constrain the shape: with the true shape and
the true Sun, axes and faces give the same angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.models.pinhole import View
from lunarsim.onboard.perception import _image_quality_kernels as kernels
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.lit_faces import BLACK, GREY, MOST_GREY, lit_faces
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.onboard.perception.sun_angle import (
    PRIOR_NUMBER,
    SunAngle,
    doubled_axes,
    local_relative_brightness,
    mean_angle,
    viewing_angles,
)
from lunarsim.typing import Array, IntArray

Complex = NDArray[np.complex128]

# Range of q: smaller patches are completely grey, and in larger ones optics contribute little grey.
_MIN_Q, _MAX_Q = 4.0, 9.0
# Maximum distance of grey and bright pixels from a patch, pixels.
_RING_PX = 3
# Minimum sums of black and of lit pixels, and minimum distance of their centroids, pixels.
_MIN_SUM, _MIN_GAP_PX = 0.3, 0.3
# Systematic differences of axes and of faces under the true shape of rocks, rad. The first reduces
# the weight of shapes that fit worse, the second bounds the accuracy of the angle.
_AXIS_SIGMA_RAD, _FACE_SIGMA_RAD = float(np.deg2rad(8.0)), float(np.deg2rad(2.5))
# Relative uncertainty of the shift by faces towards the camera.
_FACE_SHIFT_RATIO = 0.2
# Tolerance (rad) and maximum number of iterations about the current Sun direction.
_TOLERANCE_RAD, _MAX_ITERATIONS = float(np.deg2rad(2.0)), 4
# Reject all shape hypotheses if the total likelihood is below this threshold.
_MIN_LIKELIHOOD = float(np.exp(-4.5))
# Grey and bright faces disagree beyond this many standard deviations.
_DISAGREEMENT_SIGMAS = 3.0

_NO_ANGLE = SunAngle(float("nan"), float("inf"), 0.0, 0)


def high_sun_angle(
    seen: Detections,
    view: View,
    points: Array,
    sun: Array,
    model: ShadowModel | ShapeMixture,
    threshold: float,
) -> SunAngle:
    """Measure the angle between shadows and their direction under an assumed high Sun.

    Lit faces of rocks and axes of their dark patches are compared with the shadow model. The angle
    is unknown (NaN) if no rock shows black and lit pixels, or if the directions do not agree with
    any rock shape.

    Parameters
    ----------
    seen, view, points, sun, model
        Detected rocks, view of the image, positions of the rocks on the terrain (n, 3), ENU, m,
        assumed direction towards the Sun (3,), ENU, and model of the shadows.
    threshold
        Relative excess over lit terrain from which a pixel counts as bright.
    """
    rocks, lit_to_black = _lit_to_black_vectors(seen, view, points, threshold)
    if len(rocks) == 0:
        return _NO_ANGLE
    lit_to_black = lit_to_black / abs(lit_to_black)
    # Axes are vectors at twice their angle from east.
    sun_azimuth = _sun_azimuth(sun)
    axes = doubled_axes(seen.length[rocks], seen.width[rocks], seen.skew[rocks]) * sun_azimuth**2
    turned, found = 0.0, _NO_ANGLE
    for _ in range(_MAX_ITERATIONS):
        # Which faces the camera sees depends on the Sun direction, so iterate.
        found = _angle_under_sun(
            sun_azimuth * np.exp(1j * turned), lit_to_black, axes, view, points[rocks], model
        )
        if not np.isfinite(found.angle):
            return _NO_ANGLE
        turned += found.angle
        if abs(found.angle) < _TOLERANCE_RAD:
            break
    wrapped = float(np.angle(np.exp(1j * turned)))
    return SunAngle(wrapped, found.sigma, found.side, len(rocks))


def more_accurate_angle(first: SunAngle, second: SunAngle) -> SunAngle:
    """Return the more accurate of two angles, or an unknown angle if they disagree.

    They disagree if their difference exceeds three standard deviations.
    """
    if np.isfinite(first.sigma) and np.isfinite(second.sigma):
        apart = np.angle(np.exp(1j * (first.angle - second.angle)))
        if abs(apart) > _DISAGREEMENT_SIGMAS * np.hypot(first.sigma, second.sigma):
            return _NO_ANGLE
    return min(first, second, key=lambda angle: angle.sigma)


def _sun_azimuth(sun: Array) -> complex:
    """Return the azimuth of the Sun as a unit vector, east real and north imaginary."""
    towards = complex(sun[0], sun[1])
    return towards / abs(towards)


def _angle_under_sun(
    sun_azimuth: complex,
    lit_to_black: Complex,
    axes: Complex,
    view: View,
    points: Array,
    model: ShadowModel | ShapeMixture,
) -> SunAngle:
    """Estimate the angle by which shadows differ from those of an assumed Sun.

    Vectors are complex, with east as real and north as imaginary part. `sun_azimuth` is a unit
    vector towards the Sun, `lit_to_black` (n,) are unit vectors from the lit face of each rock to
    its black pixels, and `axes` (n,) the axes of dark patches as vectors at twice their angle.
    `points` (n, 3) are the positions of the rocks, m.
    """
    seen_at = viewing_angles(view, points, np.array([sun_azimuth.real, sun_azimuth.imag, 0.0]))
    models = model.models if isinstance(model, ShapeMixture) else (model,)
    shares = model.shape_fractions if isinstance(model, ShapeMixture) else np.ones(1)
    estimates = []
    for one, share in zip(models, shares, strict=True):
        direction, axis = lit_faces(one, *seen_at)
        faces = lit_to_black * np.conj(sun_azimuth * direction)
        beside = abs(np.angle(-direction))
        drawn = _FACE_SHIFT_RATIO * float(np.average(beside, weights=abs(direction) + 1e-9))
        estimates.append(
            _angle_for_shape(faces, axes * np.conj(sun_azimuth**2 * axis), float(share), drawn)
        )
    return _combine(estimates, len(lit_to_black))


def _lit_to_black_vectors(
    seen: Detections, view: View, points: Array, threshold: float
) -> tuple[IntArray, Complex]:
    """Find rocks with separate black and lit parts; return their indices and vectors.

    The horizontal vectors (n,) point from lit to black; east is real, north imaginary. `points` are
    the positions of all rocks, m. `threshold` is the excess over lit terrain from which a pixel
    counts as bright.
    """
    ring = cv2.dilate(seen.rock, np.ones((2 * _RING_PX + 1, 2 * _RING_PX + 1), np.uint8))
    sums = kernels.sum_black_and_lit(
        seen.relative,
        local_relative_brightness(seen),
        seen.rock,
        ring,
        len(seen),
        BLACK,
        GREY,
        MOST_GREY,
        threshold,
    )[1:]
    black, lit = sums[:, kernels.BLACK], sums[:, kernels.LIT]
    shown = (black > _MIN_SUM) & (lit > _MIN_SUM)
    shown &= (seen.q >= _MIN_Q) & (seen.q <= _MAX_Q)
    rocks = np.flatnonzero(shown & np.isfinite(points).all(1))
    sums, black, lit = sums[rocks], black[rocks, None], lit[rocks, None]
    lit_to_black = sums[:, [kernels.BLACK_U, kernels.BLACK_V]] / black
    lit_to_black -= sums[:, [kernels.LIT_U, kernels.LIT_V]] / lit
    apart = np.hypot(*lit_to_black.T) > _MIN_GAP_PX
    rocks, lit_to_black = rocks[apart], lit_to_black[apart]
    moves = view.pinhole.jacobian(
        (points[rocks] - view.position) @ view.enu_to_sensor.T, view.enu_to_sensor[:, :2]
    )
    return rocks, np.linalg.solve(moves, lit_to_black[:, :, None])[:, :, 0] @ np.array([1.0, 1.0j])


@dataclass(frozen=True)
class _ShapeAngle:
    """Angle between shadows and their expected direction under one rock shape.

    Attributes
    ----------
    angle, sigma
        Angle and its standard deviation, rad; infinite deviation if unknown.
    side
        Significance of the side on which lit faces lie, in standard deviations.
    weight
        Weight of the shape.
    """

    angle: float
    sigma: float
    side: float
    weight: float


def _angle_for_shape(
    faces: Complex, axes: Complex, prior: float, common_sigma: float
) -> _ShapeAngle:
    """Estimate the angle between shadows and expectation under one rock shape.

    `faces` and `axes` (n,) are complex vectors relative to their expected directions, axes at twice
    the angle. `prior` is the fraction of rocks with this shape, and `common_sigma` the error common
    to all faces, 1 sigma, rad.
    """
    angle, sigma = mean_angle(faces)
    sigma = float(np.hypot(sigma, common_sigma))
    if not np.isfinite(sigma):
        return _ShapeAngle(0.0, np.inf, 0.0, prior)
    along = np.real(faces * np.exp(-1j * angle))
    # For random directions, half of the squared sum lies along a given line.
    square = float((abs(faces) ** 2).sum())
    spread = np.sqrt(0.5 * square * (1.0 + PRIOR_NUMBER / len(faces)))
    turned, axis_sigma = mean_angle(axes)
    likelihood = 1.0
    if np.isfinite(axis_sigma):
        off = 0.5 * np.angle(np.exp(1j * (turned - 2.0 * angle)))
        likelihood = float(
            np.exp(-0.5 * off**2 / (0.25 * axis_sigma**2 + sigma**2 + _AXIS_SIGMA_RAD**2))
        )
    return _ShapeAngle(angle, sigma, float(along.sum() / spread), prior * likelihood)


def _combine(estimates: list[_ShapeAngle], number: int) -> SunAngle:
    """Average the angle over the hypotheses of the rock shape.

    `number` is the number of rocks. The result is an unknown angle if all shapes fit badly.
    `estimates` are the angles under each shape.
    """
    weight = np.array([one.weight for one in estimates])
    known = np.array([np.isfinite(one.sigma) for one in estimates])
    if weight.sum() < _MIN_LIKELIHOOD or weight[known].sum() < 0.5 * weight.sum():
        return _NO_ANGLE
    weight = np.where(known, weight, 0.0) / weight[known].sum()
    vector = np.exp(1j * np.array([one.angle for one in estimates]))
    mean = weight @ vector
    # The difference between shapes adds to the uncertainty.
    shapes = weight @ np.angle(vector * np.conj(mean)) ** 2
    scatter = (
        weight @ np.array([one.sigma if np.isfinite(one.sigma) else 0.0 for one in estimates]) ** 2
    )
    sigma = float(np.sqrt(scatter + shapes + _FACE_SIGMA_RAD**2))
    side = float(weight @ np.array([one.side for one in estimates]))
    return SunAngle(float(np.angle(mean)), sigma, side, number)
