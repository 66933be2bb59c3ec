"""Measure the direction of shadows to check the assumed Sun direction."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.models.pinhole import View
from lunarsim.onboard.perception import _image_quality_kernels as kernels
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.high_sun_direction import high_sun_angle, more_accurate_angle
from lunarsim.onboard.perception.lit_faces import LEAST_ELEVATION
from lunarsim.onboard.perception.segmentation import lit_terrain_brightness
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
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.value_checks import check_shape

# Brightness of a lit face relative to the terrain, and its maximum distance from the shadow, pixels
# (or 0.7 q, whichever is larger).
_FACE_BRIGHTNESS_RATIO = 1.15
_RING_PX = 3
# Minimum excess brightness of a lit face, minimum sum of the excess beyond it, and minimum distance
# between the centres of face and shadow, pixels.
_MIN_FACE_EXCESS, _MIN_FACE_SUM, _MIN_GAP_PX = 0.05, 0.3, 0.7
# Assumed centre of a lit face, in radii: towards the Sun, and up.
_FACE_OFFSET, _FACE_HEIGHT = 0.6, 0.5
# Minimum expected distance from face to shadow, in radii.
_MIN_EXPECTED_GAP = 0.7
# Minimum q and expected elongation of patches with an axis. Axes known to better than this angle
# take precedence over faces, rad.
_MIN_AXIS_Q, _MIN_ELONGATION, _PRECISE_AXIS_SIGMA_RAD = 4.0, 0.15, float(np.deg2rad(3.0))
# Minimum q of patches whose face can be separated from bright terrain behind them.
_MIN_FACE_Q = 3.0
# Smaller patches also count if the mean resultant length of all directions exceeds this value,
# since bright terrain lies on any side.
_MIN_FACE_AGREEMENT = 0.8
# Faces overrule axes if there are at least this many of them, and if they agree: pairs of minimum
# mean resultant length and difference from the axes, rad. With rocks on 15 % of the terrain, faces
# have errors of up to 16 deg, axes of up to 45 deg.
_MIN_FACES_FOR_VETO = 20
_FACE_VETO_LIMITS = ((0.7, float(np.deg2rad(27.0))), (0.88, float(np.deg2rad(15.0))))
# Error of axes however many there are, rad, from rendered shadows and the model. It also bounds the
# accuracy of faces that overrule axes.
_AXIS_MODEL_SIGMA_RAD = float(np.deg2rad(3.0))


def shadow_directions(image: ArrayLike, seen: Detections, rocks: IntArray | None = None) -> Array:
    """Return the image direction from each rock's lit face to its shadow (n, 2).

    The directions are unit vectors, right and down. The lit face is the weighted mean of the
    pixels near the rock's dark patch that are brighter than lit terrain. NaN where there is none.

    Parameters
    ----------
    image
        Image of the detections (height, width).
    seen
        Detected rocks.
    rocks
        Indices of the rocks to evaluate (n,); default: all.

    Raises
    ------
    InputError
        If the image does not have the shape of the detections.
    """
    grey = np.asarray(image, dtype=np.float64)
    check_shape("image", grey, seen.labels.shape, "like the image of the detections")
    relative = grey / lit_terrain_brightness(grey.astype(np.float32))
    index = np.arange(len(seen)) if rocks is None else rocks
    out = np.full((len(index), 2), np.nan)
    for n, rock in enumerate(index):
        label = seen.label[rock]
        rows, cols = np.nonzero(seen.labels == label)
        reach = max(_RING_PX, round(0.7 * float(seen.q[rock])))
        i0, j0 = max(rows.min() - reach, 0), max(cols.min() - reach, 0)
        box = np.s_[i0 : rows.max() + reach + 1, j0 : cols.max() + reach + 1]
        here = (seen.labels[box] == label).astype(np.uint8)
        ring = cv2.dilate(here, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
        ring &= seen.labels[box] == 0
        excess = np.where(ring, np.nan_to_num(relative[box]) - _FACE_BRIGHTNESS_RATIO, 0.0).clip(
            0.0
        )
        if excess.sum() == 0.0:
            continue
        v, u = np.mgrid[: excess.shape[0], : excess.shape[1]]
        bright = np.array([(u * excess).sum(), (v * excess).sum()]) / excess.sum()
        gap = np.array([cols.mean() - j0, rows.mean() - i0]) - bright
        length = np.hypot(*gap)
        if length > 0.5:
            out[n] = gap / length
    return out


def measure_shadow_angle(
    seen: Detections,
    view: View,
    points: Array,
    sun: Array,
    model: ShadowModel | ShapeMixture,
    noise: float,
) -> SunAngle:
    """Measure the angle between shadows and their direction under the assumed Sun.

    Two cues are used. Patches are elongated along the Sun: the axes of all patches on the terrain,
    compared with those of the model, give an accurate angle with an ambiguity of half a turn. They
    give nothing under a high Sun, when patches are round. Pixels beside a patch that are brighter
    than the terrain nearby are the lit face of the rock. The direction from there to the centre of
    the patch, compared with the model, gives the complete angle. Under a high Sun, faces are no
    brighter than the terrain, and `high_sun_angle` is used. Terrain that faces the Sun is bright
    too, but lies on any side of a rock, so the mean over many rocks is used.

    Parameters
    ----------
    seen
        Detected rocks.
    view
        View of the image.
    points
        Positions of the rocks on the terrain (n, 3), ENU, m.
    sun
        Assumed direction towards the Sun (3,), ENU.
    model
        Model of the shadows.
    noise
        Noise of a pixel relative to the brightness of lit terrain.
    """
    threshold = max(_MIN_FACE_EXCESS, 4.0 * noise)
    faces, large = _face_errors(seen, view, points, sun, model, threshold)
    agree = len(faces) > 0 and bool(abs(faces.mean()) > _MIN_FACE_AGREEMENT)
    if model.elevation >= LEAST_ELEVATION:
        grey = high_sun_angle(seen, view, points, sun, model, threshold)
        found = more_accurate_angle(grey, _face_angle(faces)) if agree else grey
        return replace(found, high_sun=True)
    faces = faces if agree else faces[large]
    axis, axis_sigma = mean_angle(_axis_errors(seen, view, points, sun, model))
    found = _face_angle(faces)
    if np.isfinite(axis_sigma) and len(faces):
        # Axes repeat after half a turn, so their angles are doubled.
        axis, raw = 0.5 * axis, 0.5 * axis_sigma
        axis_sigma = float(np.hypot(raw, _AXIS_MODEL_SIGMA_RAD))
        if raw < _PRECISE_AXIS_SIGMA_RAD or axis_sigma < found.sigma:
            same = np.mean(np.real(faces * np.exp(-1j * axis))) > 0.0
            by_axes = _sun_angle(faces, axis if same else axis + np.pi, axis_sigma)
            found = _select_angle(found, by_axes, faces)
    return found


def _select_angle(by_faces: SunAngle, by_axes: SunAngle, faces: NDArray[np.complex128]) -> SunAngle:
    """Return the angle from patch axes, unless many consistent faces contradict it.

    `by_faces` and `by_axes` are the two angles, `faces` (n,) the unit vectors of the single faces.
    If the faces contradict the axes, the angle from faces is returned. Axes can be wrong: from far
    and from the side, shadows of rocks behind each other merge, and on slopes the shadows of the
    terrain itself are long.
    """
    difference = abs(np.angle(np.exp(1j * (by_faces.angle - by_axes.angle))))
    agreement = abs(faces.mean())
    if len(faces) < _MIN_FACES_FOR_VETO or agreement < _FACE_VETO_LIMITS[0][0]:
        return by_axes
    if any(agreement >= least and difference > far for least, far in _FACE_VETO_LIMITS):
        return replace(by_faces, sigma=float(np.hypot(by_faces.sigma, _AXIS_MODEL_SIGMA_RAD)))
    return replace(by_axes, by_faces=by_faces.angle)


def _face_angle(faces: NDArray[np.complex128]) -> SunAngle:
    """Return the mean angle from expected to measured face directions.

    `faces` (n,) are these angles as complex unit vectors, from `_face_errors`.
    """
    angle, sigma = mean_angle(faces)
    return _sun_angle(faces, angle, sigma)


def _sun_angle(faces: NDArray[np.complex128], angle: float, sigma: float) -> SunAngle:
    """Combine an angle with the significance of the side on which lit faces lie.

    `faces` (n,) are unit vectors of single faces; `angle` and its standard deviation `sigma` are
    in rad. An infinite deviation gives an unknown angle.
    """
    if not np.isfinite(sigma):
        return SunAngle(float("nan"), float("inf"), 0.0, len(faces))
    along = np.real(faces * np.exp(-1j * angle))
    # For random directions, half of the squared sum lies along a given line.
    spread = np.sqrt(0.5 * (len(faces) + PRIOR_NUMBER))
    wrapped = float(np.angle(np.exp(1j * angle)))
    return SunAngle(wrapped, sigma, float(along.sum() / spread), len(faces))


def _axis_errors(
    seen: Detections, view: View, points: Array, sun: Array, model: ShadowModel | ShapeMixture
) -> NDArray[np.complex128]:
    """Return twice the angles from the expected to the measured patch axes (n,).

    They are the angles of complex vectors, whose length grows with expected and measured
    elongation. Small patches (q below 4) and those expected to be round are omitted. `points` are
    the positions of the rocks, m, and `sun` (3,) is the assumed direction towards the Sun, ENU.
    """
    at = np.flatnonzero((seen.q >= _MIN_AXIS_Q) & np.isfinite(points).all(1))
    azimuth, depression = viewing_angles(view, points[at], sun)
    unit = model.patch(azimuth, depression)
    expected_axis = doubled_axes(unit.length, unit.width, unit.skew)
    found = doubled_axes(seen.length[at], seen.width[at], seen.skew[at])
    is_elongated = abs(expected_axis) > _MIN_ELONGATION
    return np.asarray((found * np.conj(expected_axis))[is_elongated])


def _face_errors(
    seen: Detections,
    view: View,
    points: Array,
    sun: Array,
    model: ShadowModel | ShapeMixture,
    threshold: float,
) -> tuple[NDArray[np.complex128], BoolArray]:
    """Return the angles from expected to measured face directions as unit vectors.

    A face direction points from the lit face of a rock to its dark patch; rocks without a separate
    lit face are omitted. The vectors (n,) are complex; the second result (n,) is whether the
    shadow is large enough to separate a face from bright terrain. `points` are the positions of
    the rocks, m, `sun` (3,) is the assumed direction towards the Sun, ENU, and `threshold` the
    excess over lit terrain of bright pixels.
    """
    ring = cv2.dilate(seen.rock, np.ones((2 * _RING_PX + 1, 2 * _RING_PX + 1), np.uint8))
    sums = kernels.sum_dark_and_bright(
        local_relative_brightness(seen), seen.rock, ring, len(seen), threshold
    )[1:]
    bright = sums[:, kernels.WEIGHT] > _MIN_FACE_SUM
    at = np.flatnonzero(bright & np.isfinite(points).all(1))
    sums = sums[at]
    bright = sums[:, [kernels.BRIGHT_U, kernels.BRIGHT_V]] / sums[:, [kernels.WEIGHT]]
    gap = sums[:, [kernels.DARK_U, kernels.DARK_V]] / sums[:, [kernels.PIXELS]] - bright
    difference = np.hypot(*gap.T) > _MIN_GAP_PX
    at, gap = at[difference], gap[difference]
    moves = view.pinhole.jacobian(
        (points[at] - view.position) @ view.enu_to_sensor.T, view.enu_to_sensor[:, :2]
    )
    gap = np.linalg.solve(moves, gap[:, :, None])[:, :, 0]
    away = _expected_lit_to_dark(view, points[at], sun, model)
    turned = (gap @ [1.0, 1.0j]) * np.conj(away @ [1.0, 1.0j])
    far = np.hypot(*away.T) > _MIN_EXPECTED_GAP
    turned /= np.maximum(abs(turned), 1e-12)
    return np.asarray(turned[far]), np.asarray(seen.q[at][far] >= _MIN_FACE_Q)


def _expected_lit_to_dark(
    view: View, points: Array, sun: Array, model: ShadowModel | ShapeMixture
) -> Array:
    """Return the expected vectors from lit faces to dark patches (n, 2), in radii.

    The vectors are horizontal (east, north) for rocks at `points` (n, 3), m. `sun` (3,) is the
    assumed direction towards the Sun, ENU.
    """
    towards = sun[:2] / np.hypot(sun[0], sun[1])
    left = np.array([-towards[1], towards[0]])
    sight = points - view.position
    unit = model.patch(*viewing_angles(view, points, sun))
    dark = unit.along[:, None] * towards + unit.across[:, None] * left
    # A point above the terrain appears in front of terrain farther away.
    parallax = sight[:, :2] / np.maximum(-sight[:, 2:], 1e-9)
    return np.asarray(dark - _FACE_OFFSET * towards - _FACE_HEIGHT * parallax)


def mean_direction(directions: Array) -> tuple[float, float, int]:
    """Return median angle, half the 95 % confidence interval and number of directions.

    `directions` (n, 2) are vectors; NaN is ignored. Angles are in radians from the first axis
    towards the second. The interval is that of a mean with the observed spread (median absolute
    deviation). With fewer than three directions, angle and interval are NaN.
    """
    good = directions[np.isfinite(directions).all(1)]
    if len(good) < 3:
        return float("nan"), float("nan"), len(good)
    middle = good.mean(0)
    start = np.arctan2(middle[1], middle[0])
    turn = np.angle(np.exp(1j * (np.arctan2(good[:, 1], good[:, 0]) - start)))
    centre = float(np.median(turn))
    spread = 1.4826 * float(np.median(np.abs(turn - centre)))
    return start + centre, 1.96 * 1.25 * spread / np.sqrt(len(good)), len(good)
