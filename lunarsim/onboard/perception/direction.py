"""In which direction shadows point, from the image alone: a check on the Sun that is assumed."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.models.pinhole import View
from lunarsim.onboard.perception import _health_kernels as kernels
from lunarsim.onboard.perception.detector import Detections, DetectorSettings
from lunarsim.onboard.perception.high_sun import high_sun_angle, more_certain
from lunarsim.onboard.perception.lit_faces import LEAST_ELEVATION
from lunarsim.onboard.perception.segmentation import lit_ground
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

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# A lit face is brighter than the ground by this factor, and within so many pixels of the shadow or
# 0.7 q, whichever is more.
_FACE_BRIGHTNESS_RATIO = 1.15
_RING_PX = 3
# How much brighter than the ground a lit face is at least; sum of what its pixels have more than
# that; pixels from its middle to that of the shadow.
_MIN_FACE_EXCESS, _MIN_FACE_SUM, _MIN_GAP_PX = 0.05, 0.3, 0.7
# Where the middle of a lit face is taken to be, in radii: towards the Sun, and up.
_FACE_OFFSET, _FACE_HEIGHT = 0.6, 0.5
# Ways from face to shadow that seem shorter than this, in radii, tell nothing.
_MIN_EXPECTED_GAP = 0.7
# Patches of fewer pixels across have no axis, nor those that should be rounder than this; axes
# known to this angle tell better than faces, rad.
_MIN_AXIS_Q, _MIN_ELONGATION, _PRECISE_AXIS_SIGMA_RAD = 4.0, 0.15, float(np.deg2rad(3.0))
# Patches of fewer pixels across have no face that is told from bright ground behind them.
_MIN_FACE_Q = 3.0
# Smaller ones count too where directions of all agree so well, as a mean of vectors of length 1:
# bright ground lies on any side.
_MIN_FACE_AGREEMENT = 0.8
# So many faces are believed before axes that are so far off them, rad, if their directions agree so
# well: of rocks that cover 15 % of the ground faces are turned by up to 16 deg, axes by up to 45.
_MIN_FACES_FOR_VETO = 20
_FACE_VETO_LIMITS = ((0.7, float(np.deg2rad(27.0))), (0.88, float(np.deg2rad(15.0))))
# What axes are off by however many there are, rad, as found between rendered shadows and the model;
# faces that are believed before them err by that at least.
_AXIS_MODEL_SIGMA_RAD = float(np.deg2rad(3.0))


def shadow_directions(image: ArrayLike, seen: Detections, rocks: Index | None = None) -> Array:
    """Return the direction from each rock's lit face to its shadow (n, 2), image axes.

    The middle of the pixels round a patch that are brighter than the ground is the lit face. NaN
    where there is none.

    Parameters
    ----------
    image
        That in which the rocks were found (height, width).
    seen
        The rocks.
    rocks
        Those of them to look at (n,); left out: all.
    """
    grey = np.asarray(image, dtype=np.float64)
    if grey.shape != seen.labels.shape:
        raise InputError("image", grey.shape, f"the shape of the detections, {seen.labels.shape}")
    relative = grey / lit_ground(grey.astype(np.float32), DetectorSettings().window)
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


def turn_from_sun(
    seen: Detections,
    view: View,
    points: Array,
    sun: Array,
    model: ShadowModel | ShapeMixture,
    noise: float,
) -> SunAngle:
    """Measure by what angle shadows fall beside where the assumed Sun would throw them.

    Two things tell. Patches are long along the Sun: the axes of all, as seen on the ground, against
    those of the model's patches give the angle closely, but not which end is which, and nothing
    where the Sun is so high that patches are round. And pixels beside a patch that are brighter
    than the ground close about are the rock's lit face: from there to the middle of the patch,
    compared with where the model has the patch and with a face half way up the rock, is the whole
    angle.
    Under a high Sun, faces are no brighter than the ground: see `turn_by_grey`.
    Ground that faces the Sun is bright too, but lies on any side of a rock; so the mean over rocks
    counts, not what a single one says.

    Parameters
    ----------
    seen
        Rocks in the picture.
    view
        From where they are seen.
    points
        Rocks' places on the ground (n, 3), ENU, m.
    sun
        Direction towards the Sun as it is assumed (3,), ENU.
    model
        What patch a rock shows.
    noise
        Of a pixel over the brightness of lit ground.
    """
    threshold = max(_MIN_FACE_EXCESS, 4.0 * noise)
    faces, large = _face_errors(seen, view, points, sun, model, threshold)
    agree = len(faces) > 0 and bool(abs(faces.mean()) > _MIN_FACE_AGREEMENT)
    if model.elevation >= LEAST_ELEVATION:
        grey = high_sun_angle(seen, view, points, sun, model, threshold)
        found = more_certain(grey, _face_angle(faces)) if agree else grey
        return replace(found, high_sun=True)
    faces = faces if agree else faces[large]
    axis, axis_sigma = mean_angle(_axis_errors(seen, view, points, sun, model))
    found = _face_angle(faces)
    if np.isfinite(axis_sigma) and len(faces):
        # Axes come back after half a turn: their angles are doubled.
        axis, raw = 0.5 * axis, 0.5 * axis_sigma
        axis_sigma = float(np.hypot(raw, _AXIS_MODEL_SIGMA_RAD))
        if raw < _PRECISE_AXIS_SIGMA_RAD or axis_sigma < found.sigma:
            same = np.mean(np.real(faces * np.exp(-1j * axis))) > 0.0
            by_axes = _sun_angle(faces, axis if same else axis + np.pi, axis_sigma)
            found = _select_angle(found, by_axes, faces)
    return found


def _select_angle(by_faces: SunAngle, by_axes: SunAngle, faces: NDArray[np.complex128]) -> SunAngle:
    """Return the angle of the axes, but where many faces (n,) that are alike deny it.

    Then patches lie along something else: seen from far and from the side, those of rocks that
    stand one behind the other run into each other, and on slopes the ground's own are long.
    """
    difference = abs(np.angle(np.exp(1j * (by_faces.angle - by_axes.angle))))
    agreement = abs(faces.mean())
    if len(faces) < _MIN_FACES_FOR_VETO or agreement < _FACE_VETO_LIMITS[0][0]:
        return by_axes
    if any(agreement >= least and difference > far for least, far in _FACE_VETO_LIMITS):
        return replace(by_faces, sigma=float(np.hypot(by_faces.sigma, _AXIS_MODEL_SIGMA_RAD)))
    return replace(by_axes, by_faces=by_faces.angle)


def _face_angle(faces: NDArray[np.complex128]) -> SunAngle:
    """Return what lit faces (n,) tell."""
    angle, sigma = mean_angle(faces)
    return _sun_angle(faces, angle, sigma)


def _sun_angle(faces: NDArray[np.complex128], angle: float, sigma: float) -> SunAngle:
    """Return an angle with what faces (n,) say of its side."""
    if not np.isfinite(sigma):
        return SunAngle(float("nan"), float("inf"), 0.0, len(faces))
    along = np.real(faces * np.exp(-1j * angle))
    # Of directions that are any, half of the square lies along a line.
    spread = np.sqrt(0.5 * (len(faces) + PRIOR_NUMBER))
    wrapped = float(np.angle(np.exp(1j * angle)))
    return SunAngle(wrapped, sigma, float(along.sum() / spread), len(faces))


def _axis_errors(
    seen: Detections, view: View, points: Array, sun: Array, model: ShadowModel | ShapeMixture
) -> NDArray[np.complex128]:
    """Return twice the angles from the axes of the model's patches to those seen (n,).

    The vectors are the longer, the longer patches should be and are.
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
) -> tuple[NDArray[np.complex128], NDArray[np.bool_]]:
    """Return directions from lit faces to shadows (n,), of length 1, from where they should be.

    And of which the shadow is large enough to be told from bright ground (n,).
    """
    ring = cv2.dilate(seen.rock, np.ones((2 * _RING_PX + 1, 2 * _RING_PX + 1), np.uint8))
    sums = kernels.two_sides(
        local_relative_brightness(seen), seen.rock, ring, len(seen), threshold
    )[1:]
    bright = sums[:, kernels.WEIGHT] > _MIN_FACE_SUM
    at = np.flatnonzero(bright & np.isfinite(points).all(1))
    sums = sums[at]
    bright = sums[:, [kernels.BRIGHT_U, kernels.BRIGHT_V]] / sums[:, [kernels.WEIGHT]]
    gap = sums[:, [kernels.DARK_U, kernels.DARK_V]] / sums[:, [kernels.PIXELS]] - bright
    difference = np.hypot(*gap.T) > _MIN_GAP_PX
    at, gap = at[difference], gap[difference]
    moves = view.pinhole.jacobian((points[at] - view.position) @ view.into.T, view.into[:, :2])
    gap = np.linalg.solve(moves, gap[:, :, None])[:, :, 0]
    away = _expected_gap(view, points[at], sun, model)
    turned = (gap @ [1.0, 1.0j]) * np.conj(away @ [1.0, 1.0j])
    far = np.hypot(*away.T) > _MIN_EXPECTED_GAP
    turned /= np.maximum(abs(turned), 1e-12)
    return np.asarray(turned[far]), np.asarray(seen.q[at][far] >= _MIN_FACE_Q)


def _expected_gap(
    view: View, points: Array, sun: Array, model: ShadowModel | ShapeMixture
) -> Array:
    """Return the way from lit faces to dark patches as seen on the ground (n, 2), in radii."""
    towards = sun[:2] / np.hypot(sun[0], sun[1])
    left = np.array([-towards[1], towards[0]])
    sight = points - view.position
    unit = model.patch(*viewing_angles(view, points, sun))
    dark = unit.along[:, None] * towards + unit.side[:, None] * left
    # What is above the ground is seen before ground that lies farther off.
    lean = sight[:, :2] / np.maximum(-sight[:, 2:], 1e-9)
    return np.asarray(dark - _FACE_OFFSET * towards - _FACE_HEIGHT * lean)


def mean_direction(directions: Array) -> tuple[float, float, int]:
    """Return the median angle of directions (n, 2), half its 95 % interval, and their number.

    Angles are in radians from the first axis towards the second. The interval is that of a mean
    of so many angles with the spread found (median absolute deviation).
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
