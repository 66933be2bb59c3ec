"""Light and shadow: which pixels of an image are dark against their surroundings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError

# The brightness of lit ground is taken from an image this many times smaller.
_GROUND_SCALE = 8
# That of the slopes close by: from one so many times smaller, over so many of its pixels.
_SLOPE_SCALE, _SLOPE_WINDOW = 4, 5
# Slopes are no darker than this share of the way from shadow to lit ground: what is, is shadow.
_MIN_SLOPE_LEVEL = 0.2
# A shadow is darker than this share of the lit ground about it, whatever the histogram says.
_MAX_SHADOW_RATIO = 0.6
# Levels between shadow and lit ground at which a shadow ends: of one that is wider than three
# pixels, and of a smaller one, which optics fill with light.
_LARGE_SHADOW_LEVEL, _SMALL_SHADOW_LEVEL = 0.5, 0.62
# Standard deviations of the noise by which shadow must differ from lit ground.
_MIN_CONTRAST_SIGMAS = 5.0
# As many darkest pixels as say how dark shadow is.
_CORE_PIXELS = 24
# Every so many pixels and rows tell how lit ground varies.
_PIXEL_STRIDE = 2


@dataclass(frozen=True)
class Segmentation:
    """Shadowed pixels of one image.

    Attributes
    ----------
    dark
        (height, width), uint8 0 or 1.
    deep
        The same, but darker than half way from shadow to lit ground (height, width).
    brightness
        Gamma-corrected brightness over that of the lit ground nearby, 8 bits (height, width).
    relative
        Brightness over that of the slopes close by, were they lit (height, width).
    over_ground
        Brightness over that of the lit ground nearby, slopes as they are (height, width).
    left_out
        Pixels that are no numbers (height, width); None if all are.
    """

    dark: NDArray[np.uint8]
    deep: NDArray[np.uint8]
    brightness: NDArray[np.uint8]
    relative: NDArray[np.float32]
    over_ground: NDArray[np.float32]
    left_out: NDArray[np.bool_] | None = None


def segment(image: ArrayLike, *, gamma: float = 0.7, window: float = 0.12) -> Segmentation:
    """Find the shadowed pixels.

    The image is divided by the brightness of the lit ground nearby, then by that of the slopes
    close by, and gamma-corrected. How dark shadow is and how much lit ground varies are taken from
    the image itself; the threshold lies half way between, for small shadows above.

    Parameters
    ----------
    image
        Counts or radiance (height, width); NaN for pixels to leave out.
    gamma
        Exponent; below 1 it spreads dark tones.
    window
        Side of the surroundings, a share of the image's width.

    Raises
    ------
    InputError
        If the image has not two axes or is not numeric.
    """
    raw = np.asarray(image)
    if raw.ndim != 2 or raw.size == 0 or raw.dtype.kind not in "uifb":
        raise InputError("image", f"{raw.dtype} {raw.shape}", "numbers in an array (height, width)")
    if not (np.isfinite(gamma) and gamma > 0.0):
        raise InputError("gamma", gamma, "a positive number")
    valid = np.isfinite(raw) if raw.dtype.kind == "f" else np.ones(raw.shape, bool)
    grey = raw.astype(np.float32)
    if not valid.all():
        if not valid.any():
            return _no_shadows(raw.shape, ~valid)
        grey = np.where(valid, grey, np.float32(np.median(grey[valid])))
    lit = lit_ground(grey, window)
    left_out = None if valid.all() else ~valid
    if not lit.max() > 0.0:
        return _no_shadows(raw.shape, left_out)
    cv2.max(lit, float(lit.max()) * 1e-3, dst=lit)
    if raw.dtype.kind in "if":
        cv2.max(grey, 0.0, dst=grey)
    ratio = cv2.divide(grey, lit, dst=grey)
    levels = _brightness_levels(ratio)
    if levels is None:
        none = np.zeros(raw.shape, np.uint8)
        return Segmentation(none, none, _gamma_corrected(ratio, gamma), ratio, ratio, left_out)
    relative = cv2.divide(ratio, _slope_brightness(ratio, *levels))
    dark, deep = _shadow_masks(relative, ratio, *levels)
    if left_out is not None:
        dark[left_out] = 0
    return Segmentation(dark, deep, _gamma_corrected(relative, gamma), relative, ratio, left_out)


def _no_shadows(shape: tuple[int, ...], left_out: NDArray[np.bool_] | None) -> Segmentation:
    none = np.zeros(shape, np.uint8)
    black = none.astype(np.float32)
    return Segmentation(none, none, none, black, black, left_out)


def lit_ground(grey: NDArray[np.float32], window: float) -> NDArray[np.float32]:
    """Return the brightness of the lit ground about each pixel (height, width).

    `window` is the side of the surroundings, a share of the width.
    """
    height, width = grey.shape
    small = cv2.resize(
        grey,
        (max(width // _GROUND_SCALE, 1), max(height // _GROUND_SCALE, 1)),
        interpolation=cv2.INTER_AREA,
    )
    side = max(3, int(window * small.shape[1]) | 1)
    # The brighter of two passes: where shadow fills most of a window, the lit rest counts.
    smooth = cv2.blur(small, (side, side), borderType=cv2.BORDER_REFLECT)
    bright = np.where(small >= 0.8 * smooth, small, np.float32(0.0))
    weight = (bright > 0.0).astype(np.float32)
    total = cv2.blur(bright, (side, side), borderType=cv2.BORDER_REFLECT)
    share = cv2.blur(weight, (side, side), borderType=cv2.BORDER_REFLECT)
    known = total / np.maximum(share, np.float32(1e-3))
    # Ground that is dark as a whole must not become its own measure.
    floor = np.float32(0.35) * np.float32(np.percentile(known, 90.0))
    known = np.maximum(known, floor).astype(np.float32)
    return np.asarray(cv2.resize(known, (width, height), interpolation=cv2.INTER_LINEAR))


def _gamma_corrected(ratio: NDArray[np.float32], gamma: float) -> NDArray[np.uint8]:
    scaled = cv2.convertScaleAbs(ratio, alpha=170.0)
    table = np.rint(255.0 * (np.arange(256) / 255.0) ** gamma).astype(np.uint8)
    return np.asarray(cv2.LUT(scaled, table))


def _brightness_levels(ratio: NDArray[np.float32]) -> tuple[float, float] | None:
    """Return how bright shadow and lit ground are, or None if the image shows no shadow."""
    # A histogram does for both: the mode of lit ground, and the darkest pixels.
    bins: Any = cv2.calcHist([ratio], [0], None, [512], [0.0, 2.0]).ravel()
    level = (np.arange(512) + 0.5) / 256.0
    total = np.cumsum(bins)
    core = float(level[np.searchsorted(total, min(_CORE_PIXELS, 0.2 * total[-1]))])
    # What is darker than a quarter of the brightest but a few is no lit ground: sky, terrain in
    # its own shadow.
    bright = float(level[min(np.searchsorted(total, 0.98 * total[-1]), 511)])
    start = total[np.searchsorted(level, 0.25 * bright) - 1]
    share = total - start
    lit = float(level[np.searchsorted(share, 0.5 * share[-1])])
    if lit - core < max(
        _MIN_CONTRAST_SIGMAS * _lit_sigma(ratio, core, lit), (1.0 - _MAX_SHADOW_RATIO) * lit
    ):
        return None
    return core, lit


def _lit_sigma(ratio: NDArray[np.float32], core: float, lit: float) -> float:
    """Return how much lit ground varies from pixel to pixel, 1 sigma."""
    sampled = ratio[::_PIXEL_STRIDE, ::_PIXEL_STRIDE]
    step = np.abs(sampled[:, 1:] - sampled[:, :-1])[sampled[:, 1:] > 0.5 * (core + lit)]
    return float(np.median(step[:: max(len(step) // 20_000, 1)])) / 0.954 if len(step) else 0.0


def _slope_brightness(ratio: NDArray[np.float32], core: float, lit: float) -> NDArray[np.float32]:
    """Return the brightness of slopes close by, over that of lit ground (height, width)."""
    height, width = ratio.shape
    size = (max(width // _SLOPE_SCALE, 1), max(height // _SLOPE_SCALE, 1))
    shown = cv2.threshold(
        ratio, core + _MIN_SLOPE_LEVEL * (lit - core), 1.0, cv2.THRESH_BINARY
    )[1]  # fmt: skip
    # Lit faces of rocks are no slopes.
    bright = cv2.multiply(cv2.min(ratio, 1.5 * lit), shown)
    side = (_SLOPE_WINDOW, _SLOPE_WINDOW)
    total = cv2.blur(cv2.resize(bright, size, interpolation=cv2.INTER_AREA), side)
    share = cv2.blur(cv2.resize(shown, size, interpolation=cv2.INTER_AREA), side)
    # Where little is lit, what is about it says less.
    sampled = np.float32(0.05)
    near = (total + sampled * np.float32(lit)) / (share + sampled)
    return np.asarray(cv2.resize(near, (width, height), interpolation=cv2.INTER_LINEAR))


def _shadow_masks(
    relative: NDArray[np.float32], ratio: NDArray[np.float32], core: float, lit: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return which pixels are shadow and which are so by half (height, width)."""
    core, darkest = core / lit, core + _MIN_SLOPE_LEVEL * (lit - core)

    def below(level: float) -> NDArray[np.uint8]:
        threshold = min(
            core + level * (1.0 - core), _MAX_SHADOW_RATIO + (level - _LARGE_SHADOW_LEVEL)
        )
        return np.asarray(cv2.inRange(relative, -1.0, threshold))

    half = below(_LARGE_SHADOW_LEVEL)
    # Terrain in its own shadow is no slope.
    cv2.bitwise_or(half, cv2.inRange(ratio, -1.0, darkest), dst=half)
    square = np.ones((3, 3), np.uint8)
    large = cv2.dilate(cv2.erode(half, square), np.ones((7, 7), np.uint8))
    small = cv2.bitwise_and(below(_SMALL_SHADOW_LEVEL), cv2.bitwise_not(large))
    return np.asarray(cv2.bitwise_or(half, small) & 1), np.asarray(half)
