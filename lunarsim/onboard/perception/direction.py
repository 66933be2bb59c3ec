"""In which direction shadows point, from the image alone: a check on the Sun that is assumed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.models.pinhole import View
from lunarsim.onboard.perception.detector import Detections, DetectorSettings
from lunarsim.onboard.perception.segmentation import lit_ground

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# A lit face is brighter than the ground by this factor, and within so many pixels of the shadow or
# 0.7 q, whichever is more.
_BRIGHT = 1.15
_RING = 3
# Rocks that tell enough of the direction of all shadows.
_MOST = 24


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
    image: ArrayLike, seen: Detections, view: View, points: Array, sun: Array
) -> tuple[float, float, int]:
    """Return by what angle shadows fall beside where the assumed Sun would throw them.

    Parameters
    ----------
    image, seen
        As for `shadow_directions`; only the largest rocks are looked at.
    view
        From where they are seen.
    points
        Rocks' places on the ground (n, 3), ENU, m.
    sun
        Direction towards the Sun as it is assumed (3,), ENU.

    Returns
    -------
    angle, sigma, number
        In the image, rad, the standard deviation of what chance makes of it, and of how many
        rocks. NaN if there are fewer than three.
    """
    rocks = np.argsort(-seen.q, kind="stable")[:_MOST]
    found = shadow_directions(image, seen, rocks)
    seen_from = (points[rocks] - view.position) @ view.axes
    moves = view.pinhole.jacobian(seen_from, view.axes[:2].T)
    away = -(moves @ (np.asarray(sun)[:2] / np.hypot(sun[0], sun[1])))
    # Angles from where each shadow should point; the same turn for all of them.
    across = away[:, 0] * found[:, 1] - away[:, 1] * found[:, 0]
    turned = np.column_stack((np.einsum("ij,ij->i", away, found), across))
    with np.errstate(invalid="ignore"):
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    angle, half, number = mean_direction(turned)
    return float(np.angle(np.exp(1j * angle))), half / 1.96, number


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
