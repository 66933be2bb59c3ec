"""Quality check of camera images before they are used for hazard mapping.

A map is based on what images do not show. An image is therefore used only if it proves that rocks
would be visible: it is exposed, sharp, new and complete, it contains shadows, and these point away
from the Sun. A covered lens or terrain without rocks proves nothing and is not used.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from lunarsim.frames import is_position, is_rotation
from lunarsim.models.camera import CameraModel
from lunarsim.models.pinhole import View
from lunarsim.models.pose import Pose
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.edge_widths import MIN_WIDTH, EdgeWidths, edge_widths
from lunarsim.onboard.perception.sun_angle import SunAngle
from lunarsim.typing import BoolArray

# Stride of the pixels and rows from which fractions of the image are estimated.
_PIXEL_STRIDE = 4
# Number of bands along each side of the image; each of them must pass.
_BAND_COUNT = 8
# Quantile of the response, from the quietest pixels, from which noise is estimated.
_NOISE_QUANTILE = 0.25
# Counts that read noise alone can produce; minimum fraction of the pixels above them.
_MAX_BLACK_COUNTS, _MIN_LIT_FRACTION = 3, 0.02
# Terrain below this fraction of the lit brightness may be missing. A missing line has more than the
# second fraction of such pixels, and a line beside a straight end less than the third.
_MISSING_BRIGHTNESS_RATIO, _MISSING_LINE_DARK, _NEIGHBOUR_LINE_DARK = 0.15, 0.98, 0.6
# Quantile of the shadowed pixels that defines the brightness of shadows.
_SHADE_QUANTILE = 0.01
# Number of earlier frames with which an image is compared, since a buffer may be read repeatedly.
_COMPARED_FRAMES = 3

# Limits of an accepted image. Minimum counts of lit terrain; one count is then an eighth of its
# brightness.
MIN_LIT_COUNTS = 8.0
# Maximum fractions: pixels at the highest count; dark pixels, whether shadow or sky; pixels that
# are not finite, and rows or columns that are missing; lit pixels of a band that repeat an earlier
# image.
MAX_SATURATED_FRACTION, MAX_DARK_FRACTION = 0.1, 0.6
MAX_MISSING_FRACTION, MAX_REPEATED_FRACTION = 0.02, 0.9
# Maximum noise of a pixel in any part of the image, and maximum brightness of the darkest shadows,
# both relative to lit terrain.
MAX_NOISE, MAX_SHADOW_BRIGHTNESS = 0.08, 0.35
# Minimum number of rock shadows.
MIN_SHADOWS = 4
# Maximum width of the sharpest shadow edges, in any direction and in the direction with the widest
# edges, relative to that of the point spread.
MAX_EDGE_WIDTH_RATIO, MAX_SMEAR_RATIO = 1.25, 1.15
# Angle between shadows and their expected direction, rad: up to the first value the Sun direction
# is confirmed; from the second, or from the third under a high Sun, it is contradicted. Boulders
# brighter than the terrain bias the angle by up to 18 deg under a high Sun.
CONFIRM_ANGLE, _CONTRADICT_ANGLE, _HIGH_SUN_CONTRADICT_ANGLE = np.deg2rad((10.0, 15.0, 25.0))
# Maximum standard deviation of the angle for a conclusion, rad.
_MAX_ANGLE_SIGMA = float(np.deg2rad(5.0))
# Minimum significance of the side on which lit faces lie, which excludes an error of half a turn,
# standard deviations.
_MIN_SIDE_SIGNIFICANCE = 4.0
# Minimum agreement (mean resultant length) of the directions from lit faces to shadows for a
# contradiction and for a confirmation. Craters and slopes shift the angle too, but agree less.
# Where shadows merge, terrain between them is taken for lit faces on the wrong side.
_CONTRADICT_AGREEMENT, _CONFIRM_AGREEMENT = 0.55, 0.2
# Under a high Sun a less accurate angle also confirms the direction if its error is below the first
# value, rad, by the second number of standard deviations.
_MAX_CONFIRMED_ERROR, _CONFIRM_SIGMAS = float(np.deg2rad(30.0)), 3.5
# Point spread of a camera without a calibration, 1 sigma, pixels.
DEFAULT_BLUR_SIGMA = 0.6


class ImageRejection(Enum):
    """Reason for rejecting an image."""

    FORM = "size or type differs from the camera's"
    POSE = "camera pose is unknown"
    NO_NUMBERS = "too many pixels are not finite"
    FAINT = "lit terrain is too dark"
    SATURATED = "too many pixels are saturated"
    VEILED = "shadows are too bright"
    NOISE = "noise hides shadows"
    STUCK = "image repeats an earlier one, completely or in part"
    GAPS = "rows or columns are missing"
    DARK = "too much of the image is dark"
    NO_SHADOWS = "too few shadows to prove that rocks are visible"
    BLURRED = "shadow edges are blurred"
    SMEARED = "shadow edges are blurred along one direction"
    SUN_ELSEWHERE = "shadows do not point away from the Sun"
    MISPLACED = "tracked rocks are not at their predicted positions"
    SUN_UNPROVEN = "shadows do not confirm the assumed Sun direction"


# These images have no defect, but prove nothing.
_INCONCLUSIVE = frozenset({ImageRejection.NO_SHADOWS, ImageRejection.SUN_UNPROVEN})


@dataclass(frozen=True)
class ImageQuality:
    """Result of the quality check of an image.

    Attributes
    ----------
    fault
        First fault found; None: the image is accepted.
    metrics
        Metrics measured so far, by name: `lit` (brightness of lit terrain, counts), `saturated`,
        `gaps`, `dark` (fractions), `noise` (relative to lit terrain), `shadows` (number), `shade`
        (brightness of shadows relative to lit terrain), `width`, `smear` (pixels, 1 sigma of
        edges), `turn`, `turn_sigma` (angle of shadows from their expected direction, rad),
        `turn_side` (its significance, standard deviations).
    """

    fault: ImageRejection | None
    metrics: dict[str, float]

    @property
    def good(self) -> bool:
        """Whether the image is accepted."""
        return self.fault is None

    @property
    def alarm(self) -> bool:
        """Whether camera, image or Sun direction is faulty; False if the view is empty."""
        return self.fault is not None and self.fault not in _INCONCLUSIVE


@dataclass
class SunConfirmation:
    """Record whether shadows have confirmed the assumed Sun direction.

    The Sun does not move, so later images, also of other cameras of the same lander, need not
    confirm it again. An image that contradicts it withdraws the confirmation.

    Attributes
    ----------
    confirmed
        Whether the direction is confirmed.
    side
        Highest significance (`SunAngle.side`) of an image that confirmed the direction.
    """

    confirmed: bool = False
    side: float = 0.0


class ImageQualityCheck:
    """Check the quality of the images of one camera in sequence.

    Parameters
    ----------
    blur_sigma
        Calibrated point spread of the camera, 1 sigma, pixels.
    sun
        Confirmation of the Sun direction, shared with other cameras of the lander; default: a
        separate one.
    """

    def __init__(
        self, blur_sigma: float = DEFAULT_BLUR_SIGMA, sun: SunConfirmation | None = None
    ) -> None:
        self.blur_sigma = blur_sigma
        self.sun = sun or SunConfirmation()
        self._last: deque[NDArray[Any]] = deque(maxlen=_COMPARED_FRAMES)

    def before_detection(self, counts: ArrayLike, camera: CameraModel, pose: Pose) -> ImageQuality:
        """Check the pixels of an image before rocks are detected in it.

        Parameters
        ----------
        counts
            Image (camera.height, camera.width), counts or other numbers.
        camera, pose
            Camera model, and pose of the camera.
        """
        try:
            image = np.asarray(counts)
        except ValueError:
            return ImageQuality(ImageRejection.FORM, {})
        if image.shape != (camera.height, camera.width) or image.dtype.kind not in "uif":
            return ImageQuality(ImageRejection.FORM, {})
        if not (is_position(pose.position) and is_rotation(pose.attitude)):
            return ImageQuality(ImageRejection.POSE, {})
        metrics: dict[str, float] = {}
        return ImageQuality(
            self._check_counts(image, _looks_down(camera.view(pose)), metrics), metrics
        )

    def _check_counts(
        self, image: NDArray[Any], below_horizon: BoolArray, metrics: dict[str, float]
    ) -> ImageRejection | None:
        """Check the pixels of an image; return the first fault, or None.

        `below_horizon` marks the sampled pixels that show terrain; `metrics` receives the measured
        values.
        """
        sampled = image[::_PIXEL_STRIDE, ::_PIXEL_STRIDE]
        is_finite = np.isfinite(sampled)
        metrics["gaps"] = 1.0 - float(is_finite.mean())
        if metrics["gaps"] > MAX_MISSING_FRACTION:
            return ImageRejection.NO_NUMBERS
        same = self._repeated_fraction(sampled, MIN_LIT_COUNTS)
        self._last.append(sampled.copy())
        below_horizon = below_horizon & is_finite
        if not below_horizon.any():
            return ImageRejection.NO_SHADOWS
        metrics["lit"] = _lit_brightness(sampled[below_horizon])
        if not metrics["lit"] >= MIN_LIT_COUNTS:
            return ImageRejection.FAINT
        metrics["saturated"] = float(
            (sampled[below_horizon] == sampled[below_horizon].max()).mean()
        )
        if metrics["saturated"] > MAX_SATURATED_FRACTION:
            return ImageRejection.SATURATED
        metrics["gaps"] = max(metrics["gaps"], _missing_lines(image, below_horizon, metrics["lit"]))
        if metrics["gaps"] > MAX_MISSING_FRACTION:
            return ImageRejection.GAPS
        if same > MAX_REPEATED_FRACTION:
            return ImageRejection.STUCK
        metrics["noise"] = _noise(image) / metrics["lit"]
        return ImageRejection.NOISE if not metrics["noise"] <= MAX_NOISE else None

    def _repeated_fraction(self, sampled: NDArray[Any], min_brightness: float) -> float:
        """Return the maximum fraction of lit pixels that repeat an earlier image.

        The maximum is over the last images and over bands of rows and of columns; bands in which
        less than 20 % of the pixels are lit are skipped. `sampled` are the sampled pixels; those of
        at least `min_brightness`, counts, are lit.
        """
        highest = 0.0
        bright = sampled >= min_brightness
        for last in self._last:
            if last.shape != sampled.shape:
                continue
            same = bright & (sampled == last)
            for axis in (0, 1):
                for same_band, bright_band in zip(
                    np.array_split(same, _BAND_COUNT, axis),
                    np.array_split(bright, _BAND_COUNT, axis),
                    strict=True,
                ):
                    lit_here = np.count_nonzero(bright_band)
                    if lit_here >= 0.2 * bright_band.size:
                        highest = max(highest, np.count_nonzero(same_band) / lit_here)
        return highest

    def after_detection(self, seen: Detections, turn: SunAngle, noise: float) -> ImageQuality:
        """Check an image, and the assumed Sun direction, by the detected shadows.

        The result contains the first fault found: too much darkness, too few, blurred or bright
        shadows, or a Sun direction that is contradicted or not confirmed.

        Parameters
        ----------
        seen
            Detections in the image.
        turn
            Measured angle between shadows and their expected direction.
        noise
            Noise of a pixel relative to lit terrain, from `before_detection`.
        """
        dark = float((seen.labels[::_PIXEL_STRIDE, ::_PIXEL_STRIDE] > 0).mean())
        figures = {"dark": dark, "shadows": float(len(seen))}
        if dark > MAX_DARK_FRACTION:
            return ImageQuality(ImageRejection.DARK, figures)
        widths = edge_widths(seen, noise)
        figures |= {"width": widths.sharpest, "smear": widths.least_sharp_direction}
        figures |= {"turn": turn.angle, "turn_sigma": turn.sigma, "turn_side": turn.side}
        if widths.number < MIN_SHADOWS:
            return ImageQuality(ImageRejection.NO_SHADOWS, figures)
        fault = self._check_sharpness(widths)
        figures["shade"] = _shadow_brightness(seen)
        if fault is None and figures["shade"] > MAX_SHADOW_BRIGHTNESS:
            fault = ImageRejection.VEILED
        return ImageQuality(fault or self._check_sun(turn), figures)

    def _check_sharpness(self, widths: EdgeWidths) -> ImageRejection | None:
        """Return the fault of images with blurred shadow edges, or None."""
        expected = EdgeWidths.expected(self.blur_sigma)
        if not widths.sharpest <= MAX_EDGE_WIDTH_RATIO * expected:
            return ImageRejection.BLURRED
        if not widths.least_sharp_direction <= MAX_SMEAR_RATIO * max(expected, MIN_WIDTH):
            return ImageRejection.SMEARED
        return None

    def is_accurate(self, turn: SunAngle) -> bool:
        """Return whether a measured shadow angle is accurate enough to locate the Sun.

        `turn` is the angle between shadows and their expected direction.
        """
        return turn.sigma <= _MAX_ANGLE_SIGMA and turn.side >= _MIN_SIDE_SIGNIFICANCE

    def is_conclusive(self, turn: SunAngle) -> bool:
        """Return whether a shadow angle confirms or contradicts the Sun direction.

        It does if it contradicts the direction, or if it is accurate and smaller than the angle of
        a contradiction. `turn` is the angle between shadows and their expected direction.
        """
        near = abs(turn.angle) < _CONTRADICT_ANGLE
        return self.contradicts(turn) or (self.is_accurate(turn) and near)

    def contradicts(self, turn: SunAngle) -> bool:
        """Return whether a measured shadow angle contradicts the Sun direction.

        The angle must be accurate and the shadows consistent. If lit faces agree with the Sun
        direction but axes of patches do not, the axes belong to merged shadows and do not count.
        `turn` is the angle between shadows and their expected direction.
        """
        agrees = turn.high_sun or turn.agreement >= _CONTRADICT_AGREEMENT
        wrong_angle = _HIGH_SUN_CONTRADICT_ANGLE if turn.high_sun else _CONTRADICT_ANGLE
        contradicted_by_faces = abs(turn.by_faces) < wrong_angle
        return (
            self.is_accurate(turn)
            and agrees
            and abs(turn.angle) >= wrong_angle
            and not contradicted_by_faces
        )

    def _check_sun(self, turn: SunAngle) -> ImageRejection | None:
        """Compare a shadow angle with the Sun direction; return a fault, or None.

        The result is None if this image or an earlier one has confirmed the Sun direction, and
        this image gives no reason against it. Updates whether the direction is confirmed. `turn`
        is the angle between shadows and their expected direction.
        """
        if self.contradicts(turn):
            self.sun.confirmed, self.sun.side = False, 0.0
            return ImageRejection.SUN_ELSEWHERE
        is_far = (
            turn.side >= _MIN_SIDE_SIGNIFICANCE
            and abs(turn.angle) - _CONFIRM_SIGMAS * turn.sigma > CONFIRM_ANGLE
        )
        if is_far or (self.is_accurate(turn) and abs(turn.angle) >= _CONTRADICT_ANGLE):
            # Either craters and merged shadows cause this, or the Sun direction is wrong.
            self.sun.confirmed &= turn.side <= self.sun.side
            return ImageRejection.SUN_UNPROVEN
        agrees = turn.high_sun or turn.agreement >= _CONFIRM_AGREEMENT
        is_proven = (self.is_accurate(turn) and agrees) or (
            turn.high_sun
            and turn.side >= _MIN_SIDE_SIGNIFICANCE
            and abs(turn.angle) + _CONFIRM_SIGMAS * turn.sigma <= _MAX_CONFIRMED_ERROR
        )
        if is_proven and abs(turn.angle) <= CONFIRM_ANGLE:
            self.sun.confirmed, self.sun.side = True, max(self.sun.side, turn.side)
        return None if self.sun.confirmed else ImageRejection.SUN_UNPROVEN


def _shadow_brightness(seen: Detections) -> float:
    """Return the brightness of the darkest rock shadows relative to lit terrain.

    It is infinite without a rock shadow.
    """
    shaded = seen.relative[seen.rock > 0]
    at = int(_SHADE_QUANTILE * shaded.size)
    return float(np.partition(shaded, at)[at]) if shaded.size else np.inf


def _lit_brightness(pixels: NDArray[Any]) -> float:
    """Return the brightness of lit terrain among some pixels (n,), counts.

    Lit pixels have at least half of the brightness of the 90th percentile, also if most of the
    image is dark. The result is 0 if nearly all pixels are black.
    """
    shown = pixels[pixels > _MAX_BLACK_COUNTS]
    if len(shown) < _MIN_LIT_FRACTION * len(pixels):
        return 0.0
    return float(np.median(shown[shown >= 0.5 * np.percentile(shown, 90.0)]))


def _looks_down(view: View) -> BoolArray:
    """Return which of the sampled pixels of a view are below the horizon (rows, cols)."""
    u = (np.arange(0, view.width, _PIXEL_STRIDE) - view.cx) / view.fx
    v = (np.arange(0, view.height, _PIXEL_STRIDE) - view.cy) / view.fy
    up = view.axes[2]
    return np.asarray(up[0] * u + up[1] * v[:, None] + up[2] < 0.0)


def _missing_lines(image: NDArray[Any], below_horizon: BoolArray, lit: float) -> float:
    """Return the fraction of rows or columns of terrain that were not read out.

    The larger of the two fractions is returned, 0 if the image shows no terrain. `below_horizon`
    marks the sampled pixels that show terrain, and `lit` is the brightness of lit terrain, counts.
    Lines that were not read out repeat the previous line, which never happens on lit terrain, or
    they are completely dark up to a straight end, which no shadow has.
    """
    highest = 0.0
    for lines_first, below in ((image, below_horizon), (image.T, below_horizon.T)):
        lines = lines_first[:, ::_PIXEL_STRIDE]
        dark = (lines < _MISSING_BRIGHTNESS_RATIO * lit).mean(1)
        is_terrain = np.repeat(below.all(1), _PIXEL_STRIDE)[: len(lines_first)]
        is_terrain = _exclude_sky(is_terrain, dark > _MISSING_LINE_DARK)
        if not is_terrain.any():
            continue
        repeats = np.zeros(len(lines), np.bool_)
        repeats[1:] = (lines[1:] == lines[:-1]).all(1)
        empty = dark > _MISSING_LINE_DARK
        ends = (empty[1:] & (dark[:-1] < _NEIGHBOUR_LINE_DARK)) | (
            empty[:-1] & (dark[1:] < _NEIGHBOUR_LINE_DARK)
        )
        straight = (ends & is_terrain[1:] & is_terrain[:-1]).any()
        is_missing = empty | repeats if straight else repeats & ~empty
        highest = max(highest, float(is_missing[is_terrain].mean()))
    return highest


def _exclude_sky(below_horizon: BoolArray, dark: BoolArray) -> BoolArray:
    """Return which image lines (n,) show terrain, without dark lines next to the sky.

    `below_horizon` and `dark` (n,) mark the lines below the horizon and the dark lines.
    """
    out = below_horizon.copy()
    for order in (range(1, len(out)), range(len(out) - 2, -1, -1)):
        for i in order:
            before = i - 1 if order.step > 0 else i + 1
            if not out[before] and dark[i]:
                out[i] = False
    return out


def _noise(image: NDArray[Any]) -> float:
    """Return the noise of a pixel, 1 sigma, counts, in the noisiest part of the image.

    Uses the Laplacian of Immerkaer (1996, Computer Vision and Image Understanding 64), which is 0
    on a slope. Its lower quartile is insensitive to edges, also if they fill half of the image.
    The result is 0 for images below 24 pixels per side.
    """
    h, w = image.shape
    if min(h, w) < 3 * _BAND_COUNT:
        return 0.0

    def shifted(di: int, dj: int) -> NDArray[np.float32]:
        """Return the sampled pixels shifted by (di, dj)."""
        return image[
            1 + di : h - 1 + di : _PIXEL_STRIDE, 1 + dj : w - 1 + dj : _PIXEL_STRIDE
        ].astype(np.float32)

    corners = shifted(-1, -1) + shifted(-1, 1) + shifted(1, -1) + shifted(1, 1)
    sides = shifted(-1, 0) + shifted(1, 0) + shifted(0, -1) + shifted(0, 1)
    response = np.abs(corners - 2.0 * sides + 4.0 * shifted(0, 0)) / 6.0
    parts = [
        np.nanquantile(same_band, _NOISE_QUANTILE)
        for rows in np.array_split(response, _BAND_COUNT // 2)
        for same_band in np.array_split(rows, _BAND_COUNT // 2, 1)
    ]
    return float(np.max(parts)) / float(ndtri(0.5 + 0.5 * _NOISE_QUANTILE))
