"""In which direction shadows point, from the image alone: a check on the Sun that is assumed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.models.pinhole import View
from lunarsim.onboard.perception import _health_kernels as kernels
from lunarsim.onboard.perception.detector import Detections, DetectorSettings
from lunarsim.onboard.perception.segmentation import lit_ground
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture

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
# How directions of single shadows scatter is found from them as if so many more had been seen to
# scatter by so much, rad: few may agree by chance.
_USUAL_SCATTER, _USUAL_NUMBER = float(np.deg2rad(15.0)), 4


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


@dataclass(frozen=True)
class SunAngle:
    """By what angle shadows fall beside where the Sun should throw them.

    Attributes
    ----------
    angle
        In the image, rad; NaN if nothing tells.
    sigma
        Standard deviation of what chance makes of it; infinite if nothing tells.
    scatter
        Of single rocks' angles, 1 sigma, rad. Where faces towards the Sun are no brighter than the
        ground, as under a high Sun, or shadows run into each other, it is that of any direction.
    number
        Of rocks that tell.
    """

    angle: float
    sigma: float
    scatter: float
    number: int


def turn_from_sun(
    seen: Detections,
    view: View,
    points: Array,
    sun: Array,
    model: ShadowModel | ShapeMixture,
    noise: float,
) -> SunAngle:
    """Measure by what angle shadows fall beside where the assumed Sun would throw them.

    The bright pixels beside a rock's dark patch are its lit face. From there to the middle of the
    patch, both as seen on the ground, is compared with where the model has the patch and with a
    face half way up the rock: off the vertical the line between them is not along the Sun.

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
    ring = cv2.dilate(seen.rock, np.ones((2 * _RING + 1, 2 * _RING + 1), np.uint8))
    cut = max(_EXCESS, 4.0 * noise)
    sums = kernels.two_sides(seen.relative, seen.rock, ring, len(seen), cut)[1:]
    at = np.flatnonzero((sums[:, kernels.WEIGHT] > _LEAST_BRIGHT) & np.isfinite(points).all(1))
    sums = sums[at]
    bright = sums[:, [kernels.BRIGHT_U, kernels.BRIGHT_V]] / sums[:, [kernels.WEIGHT]]
    gap = sums[:, [kernels.DARK_U, kernels.DARK_V]] / sums[:, [kernels.PIXELS]] - bright
    length = np.hypot(*gap.T)
    apart = length > _LEAST_GAP
    at, gap = at[apart], gap[apart]
    moves = view.pinhole.jacobian((points[at] - view.position) @ view.axes, view.axes[:2].T)
    gap = np.linalg.solve(moves, gap[:, :, None])[:, :, 0]
    away = _expected_gap(view, points[at], sun, model)
    # Angles from where each shadow should point; the same turn for all of them.
    across = away[:, 0] * gap[:, 1] - away[:, 1] * gap[:, 0]
    turned = np.column_stack((np.einsum("ij,ij->i", away, gap), across))
    with np.errstate(invalid="ignore"):
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    angle, half, number = mean_direction(turned)
    if number < 3:
        return SunAngle(float("nan"), float("inf"), float("inf"), number)
    # The error of a median is 1.25 times that of a mean.
    found = half / 1.96 * np.sqrt(number) / 1.25
    total = number * found**2 + _USUAL_NUMBER * _USUAL_SCATTER**2
    scatter = float(np.sqrt(total / (number + _USUAL_NUMBER)))
    sigma = 1.25 * scatter / float(np.sqrt(number))
    return SunAngle(float(np.angle(np.exp(1j * angle))), sigma, scatter, number)


def _expected_gap(
    view: View, points: Array, sun: Array, model: ShadowModel | ShapeMixture
) -> Array:
    """Return the way from lit faces to dark patches as seen on the ground (n, 2), in radii."""
    towards = sun[:2] / np.hypot(sun[0], sun[1])
    left = np.array([-towards[1], towards[0]])
    sight = points - view.position
    level = np.hypot(sight[:, 0], sight[:, 1])
    azimuth = np.arctan2(-sight[:, 0], -sight[:, 1]) - np.arctan2(sun[0], sun[1])
    unit = model.patch(azimuth, np.arctan2(-sight[:, 2], level))
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
