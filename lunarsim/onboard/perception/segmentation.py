"""Segment an image into light and shadow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.typing import BoolArray

# Reduction factor of the image for the brightness of lit terrain.
_GROUND_SCALE = 8
# Exponent of the gamma correction, which expands dark tones, and side of the neighbourhood for the
# brightness of lit terrain, as a fraction of the image width.
_GAMMA, _LIT_WINDOW = 0.7, 0.12
# Reduction factor for the brightness of nearby slopes, and window in reduced pixels.
_SLOPE_SCALE, _SLOPE_WINDOW = 4, 5
# Minimum brightness of slopes, as a fraction of the way from shadow to lit terrain.
_MIN_SLOPE_LEVEL = 0.2
# Maximum brightness of a shadow relative to nearby lit terrain.
_MAX_SHADOW_RATIO = 0.6
# Threshold between shadow and lit terrain for shadows wider than three pixels, and for smaller
# ones, which the optics fill with light.
_LARGE_SHADOW_LEVEL, _SMALL_SHADOW_LEVEL = 0.5, 0.62
# Minimum contrast between shadow and lit terrain, in standard deviations of the noise.
_MIN_CONTRAST_SIGMAS = 5.0
# Number of darkest pixels that define the brightness of shadow.
_CORE_PIXELS = 24
# Stride of the pixels from which the variation of lit terrain is estimated.
_PIXEL_STRIDE = 2


@dataclass(frozen=True)
class Segmentation:
    """Shadowed pixels of one image, and its brightness relative to lit terrain.

    Attributes
    ----------
    dark
        Shadow mask (height, width), uint8 0 or 1.
    deep
        Mask of pixels darker than half way from shadow to lit terrain (height, width).
    brightness
        Gamma-corrected brightness relative to nearby lit terrain, 8 bits (height, width).
    relative
        Brightness relative to nearby slopes outside shadows (height, width).
    relative_to_lit_terrain
        Brightness relative to lit terrain in a wider neighbourhood (height, width); lit slopes
        differ from 1.
    invalid
        Mask of pixels that are not finite (height, width); None if all are finite.
    """

    dark: NDArray[np.uint8]
    deep: NDArray[np.uint8]
    brightness: NDArray[np.uint8]
    relative: NDArray[np.float32]
    relative_to_lit_terrain: NDArray[np.float32]
    invalid: BoolArray | None = None


def segment(image: ArrayLike) -> Segmentation:
    """Find the shadowed pixels of an image.

    The image is divided by the brightness of nearby lit terrain, then by that of nearby slopes, and
    is gamma-corrected. The brightness of shadow and the variation of lit terrain are estimated from
    the image itself. The threshold lies half way between shadow and lit terrain, for small shadows
    higher.

    Parameters
    ----------
    image
        Counts or radiance (height, width); NaN for invalid pixels.

    Raises
    ------
    InputError
        If the image does not have two axes or is not numeric.
    """
    raw = np.asarray(image)
    if raw.dtype.kind not in "uifb":
        problem = f"must be an array of real numbers, not of type {raw.dtype.name}"
        raise InputError("image", raw.dtype, problem, show_value=False)
    if raw.ndim != 2 or raw.size == 0:
        raise InputError("image", raw.shape, "must have shape (height, width) and contain pixels")
    valid = np.isfinite(raw) if raw.dtype.kind == "f" else np.ones(raw.shape, bool)
    grey = raw.astype(np.float32)
    if not valid.all():
        if not valid.any():
            return _no_shadows(raw.shape, ~valid)
        grey = np.where(valid, grey, np.float32(np.median(grey[valid])))
    lit = lit_terrain_brightness(grey)
    invalid = None if valid.all() else ~valid
    if not lit.max() > 0.0:
        return _no_shadows(raw.shape, invalid)
    cv2.max(lit, float(lit.max()) * 1e-3, dst=lit)
    if raw.dtype.kind in "if":
        cv2.max(grey, 0.0, dst=grey)
    ratio = cv2.divide(grey, lit, dst=grey)
    levels = _brightness_levels(ratio)
    if levels is None:
        none = np.zeros(raw.shape, np.uint8)
        return Segmentation(none, none, _gamma_corrected(ratio), ratio, ratio, invalid)
    relative = cv2.divide(ratio, _slope_brightness(ratio, *levels))
    dark, deep = _shadow_masks(relative, ratio, *levels)
    if invalid is not None:
        dark[invalid] = 0
    return Segmentation(dark, deep, _gamma_corrected(relative), relative, ratio, invalid)


def _no_shadows(shape: tuple[int, ...], invalid: BoolArray | None) -> Segmentation:
    """Return a segmentation without shadows for an image of a given shape.

    `shape` is (height, width); all brightness values are 0. `invalid` marks the pixels that are
    not finite.
    """
    none = np.zeros(shape, np.uint8)
    black = none.astype(np.float32)
    return Segmentation(none, none, none, black, black, invalid)


def lit_terrain_brightness(grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Estimate the brightness of lit terrain around each pixel (height, width).

    `grey` (height, width) is the image.
    """
    height, width = grey.shape
    small = cv2.resize(
        grey,
        (max(width // _GROUND_SCALE, 1), max(height // _GROUND_SCALE, 1)),
        interpolation=cv2.INTER_AREA,
    )
    side = max(3, int(_LIT_WINDOW * small.shape[1]) | 1)
    # Only bright pixels count, so that a window mostly in shadow is represented by its lit part.
    smooth = cv2.blur(small, (side, side), borderType=cv2.BORDER_REFLECT)
    bright = np.where(small >= 0.8 * smooth, small, np.float32(0.0))
    weight = (bright > 0.0).astype(np.float32)
    total = cv2.blur(bright, (side, side), borderType=cv2.BORDER_REFLECT)
    share = cv2.blur(weight, (side, side), borderType=cv2.BORDER_REFLECT)
    known = total / np.maximum(share, np.float32(1e-3))
    # Uniformly dark terrain must not become its own reference.
    floor = np.float32(0.35) * np.float32(np.percentile(known, 90.0))
    known = np.maximum(known, floor).astype(np.float32)
    return np.asarray(cv2.resize(known, (width, height), interpolation=cv2.INTER_LINEAR))


def _gamma_corrected(ratio: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a gamma-corrected 8-bit image of the relative brightness `ratio`."""
    scaled = cv2.convertScaleAbs(ratio, alpha=170.0)
    table = np.rint(255.0 * (np.arange(256) / 255.0) ** _GAMMA).astype(np.uint8)
    return np.asarray(cv2.LUT(scaled, table))


def _brightness_levels(ratio: NDArray[np.float32]) -> tuple[float, float] | None:
    """Estimate the brightness of shadow and of lit terrain; None without shadows.

    `ratio` (height, width) is the brightness relative to nearby lit terrain.
    """
    # One histogram gives both: the median of lit terrain, and the darkest pixels.
    bins: Any = cv2.calcHist([ratio], [0], None, [512], [0.0, 2.0]).ravel()
    level = (np.arange(512) + 0.5) / 256.0
    total = np.cumsum(bins)
    core = float(level[np.searchsorted(total, min(_CORE_PIXELS, 0.2 * total[-1]))])
    # Pixels below a quarter of the 98th percentile are not lit terrain but sky or terrain in its
    # own shadow.
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
    """Return the variation of lit terrain between neighbouring pixels, 1 sigma.

    `ratio` (height, width) is the relative brightness; `core` and `lit` are the brightness of
    shadow and of lit terrain.
    """
    sampled = ratio[::_PIXEL_STRIDE, ::_PIXEL_STRIDE]
    step = np.abs(sampled[:, 1:] - sampled[:, :-1])[sampled[:, 1:] > 0.5 * (core + lit)]
    return float(np.median(step[:: max(len(step) // 20_000, 1)])) / 0.954 if len(step) else 0.0


def _slope_brightness(ratio: NDArray[np.float32], core: float, lit: float) -> NDArray[np.float32]:
    """Return the brightness of nearby slopes relative to lit terrain (height, width).

    `ratio` (height, width) is the relative brightness; `core` and `lit` are the brightness of
    shadow and of lit terrain.
    """
    height, width = ratio.shape
    size = (max(width // _SLOPE_SCALE, 1), max(height // _SLOPE_SCALE, 1))
    shown = cv2.threshold(
        ratio, core + _MIN_SLOPE_LEVEL * (lit - core), 1.0, cv2.THRESH_BINARY
    )[1]  # fmt: skip
    # Limit lit faces of rocks, which are not slopes.
    bright = cv2.multiply(cv2.min(ratio, 1.5 * lit), shown)
    side = (_SLOPE_WINDOW, _SLOPE_WINDOW)
    total = cv2.blur(cv2.resize(bright, size, interpolation=cv2.INTER_AREA), side)
    share = cv2.blur(cv2.resize(shown, size, interpolation=cv2.INTER_AREA), side)
    # The prior stabilises the mean where little is lit.
    sampled = np.float32(0.05)
    near = (total + sampled * np.float32(lit)) / (share + sampled)
    return np.asarray(cv2.resize(near, (width, height), interpolation=cv2.INTER_LINEAR))


def _shadow_masks(
    relative: NDArray[np.float32], ratio: NDArray[np.float32], core: float, lit: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return masks of shadow and of deep shadow, 0 or 1 and 0 or 255 (height, width).

    Pixels of deep shadow are darker than half way from shadow to lit terrain; the first mask also
    has brighter pixels of small shadows. `relative` and `ratio` (height, width) are the brightness
    relative to nearby slopes and to lit terrain; `core` and `lit` are the brightness of shadow and
    of lit terrain.
    """
    core, darkest = core / lit, core + _MIN_SLOPE_LEVEL * (lit - core)

    def below(level: float) -> NDArray[np.uint8]:
        """Return the mask of pixels below a level between shadow (0) and lit terrain (1)."""
        threshold = min(
            core + level * (1.0 - core), _MAX_SHADOW_RATIO + (level - _LARGE_SHADOW_LEVEL)
        )
        return np.asarray(cv2.inRange(relative, -1.0, threshold))

    half = below(_LARGE_SHADOW_LEVEL)
    # Terrain in its own shadow is darker than any slope.
    cv2.bitwise_or(half, cv2.inRange(ratio, -1.0, darkest), dst=half)
    square = np.ones((3, 3), np.uint8)
    large = cv2.dilate(cv2.erode(half, square), np.ones((7, 7), np.uint8))
    small = cv2.bitwise_and(below(_SMALL_SHADOW_LEVEL), cv2.bitwise_not(large))
    return np.asarray(cv2.bitwise_or(half, small) & 1), np.asarray(half)
