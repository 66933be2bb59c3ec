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
from lunarsim.onboard.perception.high_sun import more_certain, turn_by_grey
from lunarsim.onboard.perception.lit_faces import LEAST_ELEVATION
from lunarsim.onboard.perception.segmentation import lit_ground
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.onboard.perception.sun_angle import (
    USUAL_NUMBER,
    SunAngle,
    above_slopes,
    doubled,
    mean_angle,
    seen_from,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# A lit face is brighter than the ground by this factor, and within so many pixels of the shadow or
# 0.7 q, whichever is more.
_BRIGHT = 1.15
_RING = 3
# How much brighter than the ground a lit face is at least; sum of what its pixels have more than
# that; pixels from its middle to that of the shadow.
_EXCESS, _LEAST_BRIGHT, _LEAST_GAP = 0.05, 0.3, 0.7
# Where the middle of a lit face is taken to be, in radii: towards the Sun, and up.
_FACE_AHEAD, _FACE_UP = 0.6, 0.5
# Ways from face to shadow that seem shorter than this, in radii, tell nothing.
_LEAST_WAY = 0.7
# Patches of fewer pixels across have no axis, nor those that should be rounder than this; axes
# known to this angle tell better than faces, rad.
_AXIS_Q, _LEAST_AXIS, _AXIS_KNOWN = 4.0, 0.15, float(np.deg2rad(3.0))
# Patches of fewer pixels across have no face that is told from bright ground behind them.
_FACE_Q = 3.0
# Smaller ones count too where directions of all agree so well, as a mean of vectors of length 1:
# bright ground lies on any side.
_AGREE = 0.8
# So many faces are believed before axes that are so far off them, rad, if their directions agree so
# well: of rocks that cover 15 % of the ground faces are turned by up to 16 deg, axes by up to 45.
_MANY_FACES = 20
_ALIKE = ((0.7, float(np.deg2rad(27.0))), (0.88, float(np.deg2rad(15.0))))
# What axes are off by however many there are, rad, as found between rendered shadows and the model;
# faces that are believed before them err by that at least.
_OFF = float(np.deg2rad(3.0))


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
        reach = max(_RING, round(0.7 * float(seen.q[rock])))
        i0, j0 = max(rows.min() - reach, 0), max(cols.min() - reach, 0)
        box = np.s_[i0 : rows.max() + reach + 1, j0 : cols.max() + reach + 1]
        here = (seen.labels[box] == label).astype(np.uint8)
        ring = cv2.dilate(here, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
        ring &= seen.labels[box] == 0
        excess = np.where(ring, np.nan_to_num(relative[box]) - _BRIGHT, 0.0).clip(0.0)
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
    cut = max(_EXCESS, 4.0 * noise)
    faces, large = _faces(seen, view, points, sun, model, cut)
    agree = len(faces) > 0 and bool(abs(faces.mean()) > _AGREE)
    if model.elevation >= LEAST_ELEVATION:
        grey = turn_by_grey(seen, view, points, sun, model, cut)
        found = more_certain(grey, _by_faces(faces)) if agree else grey
        return replace(found, high_sun=True)
    faces = faces if agree else faces[large]
    axis, axis_sigma = mean_angle(_axes(seen, view, points, sun, model))
    found = _by_faces(faces)
    if np.isfinite(axis_sigma) and len(faces):
        # Axes come back after half a turn: their angles are doubled.
        axis, raw = 0.5 * axis, 0.5 * axis_sigma
        axis_sigma = float(np.hypot(raw, _OFF))
        if raw < _AXIS_KNOWN or axis_sigma < found.sigma:
            same = np.mean(np.real(faces * np.exp(-1j * axis))) > 0.0
            by_axes = _told(faces, axis if same else axis + np.pi, axis_sigma)
            found = _of_two(found, by_axes, faces)
    return found


def _of_two(by_faces: SunAngle, by_axes: SunAngle, faces: NDArray[np.complex128]) -> SunAngle:
    """Return the angle of the axes, but where many faces (n,) that are alike deny it.

    Then patches lie along something else: seen from far and from the side, those of rocks that
    stand one behind the other run into each other, and on slopes the ground's own are long.
    """
    apart = abs(np.angle(np.exp(1j * (by_faces.angle - by_axes.angle))))
    alike = abs(faces.mean())
    if len(faces) < _MANY_FACES or alike < _ALIKE[0][0]:
        return by_axes
    if any(alike >= least and apart > far for least, far in _ALIKE):
        return replace(by_faces, sigma=float(np.hypot(by_faces.sigma, _OFF)))
    return replace(by_axes, by_faces=by_faces.angle)


def _by_faces(faces: NDArray[np.complex128]) -> SunAngle:
    """Return what lit faces (n,) tell."""
    angle, sigma = mean_angle(faces)
    return _told(faces, angle, sigma)


def _told(faces: NDArray[np.complex128], angle: float, sigma: float) -> SunAngle:
    """Return an angle with what faces (n,) say of its side."""
    if not np.isfinite(sigma):
        return SunAngle(float("nan"), float("inf"), 0.0, len(faces))
    along = np.real(faces * np.exp(-1j * angle))
    # Of directions that are any, half of the square lies along a line.
    spread = np.sqrt(0.5 * (len(faces) + USUAL_NUMBER))
    wrapped = float(np.angle(np.exp(1j * angle)))
    return SunAngle(wrapped, sigma, float(along.sum() / spread), len(faces))


def _axes(
    seen: Detections, view: View, points: Array, sun: Array, model: ShadowModel | ShapeMixture
) -> NDArray[np.complex128]:
    """Return twice the angles from the axes of the model's patches to those seen (n,).

    The vectors are the longer, the longer patches should be and are.
    """
    at = np.flatnonzero((seen.q >= _AXIS_Q) & np.isfinite(points).all(1))
    azimuth, depression = seen_from(view, points[at], sun)
    unit = model.patch(azimuth, depression)
    should = doubled(unit.length, unit.width, unit.skew)
    found = doubled(seen.length[at], seen.width[at], seen.skew[at])
    tell = abs(should) > _LEAST_AXIS
    return np.asarray((found * np.conj(should))[tell])


def _faces(
    seen: Detections,
    view: View,
    points: Array,
    sun: Array,
    model: ShadowModel | ShapeMixture,
    cut: float,
) -> tuple[NDArray[np.complex128], NDArray[np.bool_]]:
    """Return directions from lit faces to shadows (n,), of length 1, from where they should be.

    And of which the shadow is large enough to be told from bright ground (n,).
    """
    ring = cv2.dilate(seen.rock, np.ones((2 * _RING + 1, 2 * _RING + 1), np.uint8))
    sums = kernels.two_sides(above_slopes(seen), seen.rock, ring, len(seen), cut)[1:]
    bright = sums[:, kernels.WEIGHT] > _LEAST_BRIGHT
    at = np.flatnonzero(bright & np.isfinite(points).all(1))
    sums = sums[at]
    bright = sums[:, [kernels.BRIGHT_U, kernels.BRIGHT_V]] / sums[:, [kernels.WEIGHT]]
    gap = sums[:, [kernels.DARK_U, kernels.DARK_V]] / sums[:, [kernels.PIXELS]] - bright
    apart = np.hypot(*gap.T) > _LEAST_GAP
    at, gap = at[apart], gap[apart]
    moves = view.pinhole.jacobian((points[at] - view.position) @ view.into.T, view.into[:, :2])
    gap = np.linalg.solve(moves, gap[:, :, None])[:, :, 0]
    away = _expected_gap(view, points[at], sun, model)
    turned = (gap @ [1.0, 1.0j]) * np.conj(away @ [1.0, 1.0j])
    far = np.hypot(*away.T) > _LEAST_WAY
    turned /= np.maximum(abs(turned), 1e-12)
    return np.asarray(turned[far]), np.asarray(seen.q[at][far] >= _FACE_Q)


def _expected_gap(
    view: View, points: Array, sun: Array, model: ShadowModel | ShapeMixture
) -> Array:
    """Return the way from lit faces to dark patches as seen on the ground (n, 2), in radii."""
    towards = sun[:2] / np.hypot(sun[0], sun[1])
    left = np.array([-towards[1], towards[0]])
    sight = points - view.position
    unit = model.patch(*seen_from(view, points, sun))
    dark = unit.along[:, None] * towards + unit.side[:, None] * left
    # What is above the ground is seen before ground that lies farther off.
    lean = sight[:, :2] / np.maximum(-sight[:, 2:], 1e-9)
    return np.asarray(dark - _FACE_AHEAD * towards - _FACE_UP * lean)


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
