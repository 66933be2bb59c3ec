"""Light and shadow: which pixels of an image are dark against their surroundings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError

# The brightness of lit ground is taken from an image this many times smaller.
_COARSE = 8
# A shadow is darker than this share of the lit ground about it, whatever the histogram says.
_DARKEST_LIT = 0.6
# Standard deviations of the noise by which shadow must differ from lit ground.
_CONTRAST = 5.0
# As many darkest pixels as say how dark shadow is.
_CORE = 24


@dataclass(frozen=True)
class Segmentation:
    """Shadowed pixels of one image.

    Attributes
    ----------
    dark
        (height, width), uint8 0 or 1.
    brightness
        Gamma-corrected brightness over that of the lit ground nearby, 8 bits (height, width).
    relative
        Brightness over that of the lit ground nearby (height, width).
    left_out
        Pixels that are no numbers (height, width); None if all are.
    """

    dark: NDArray[np.uint8]
    brightness: NDArray[np.uint8]
    relative: NDArray[np.float32]
    left_out: NDArray[np.bool_] | None = None


def segment(image: ArrayLike, *, gamma: float = 0.7, window: float = 0.12) -> Segmentation:
    """Find the shadowed pixels.

    The image is divided by the brightness of the lit ground nearby and gamma-corrected. How dark
    shadow is and how much lit ground varies are taken from the image itself; the threshold lies
    half way between.

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
            return _nothing(raw.shape, ~valid)
        grey = np.where(valid, grey, np.float32(np.median(grey[valid])))
    lit = lit_ground(grey, window)
    left_out = None if valid.all() else ~valid
    if not lit.max() > 0.0:
        return _nothing(raw.shape, left_out)
    cv2.max(lit, float(lit.max()) * 1e-3, dst=lit)
    if raw.dtype.kind in "if":
        cv2.max(grey, 0.0, dst=grey)
    ratio = cv2.divide(grey, lit, dst=grey)
    tone = _tones(ratio, gamma)
    threshold = _threshold(ratio)
    if threshold is None:
        return Segmentation(np.zeros(raw.shape, np.uint8), tone, ratio, left_out)
    dark = (ratio < threshold).astype(np.uint8)
    if left_out is not None:
        dark[left_out] = 0
    return Segmentation(dark, tone, ratio, left_out)


def _nothing(shape: tuple[int, ...], left_out: NDArray[np.bool_] | None) -> Segmentation:
    none = np.zeros(shape, np.uint8)
    return Segmentation(none, none, none.astype(np.float32), left_out)


def lit_ground(grey: NDArray[np.float32], window: float) -> NDArray[np.float32]:
    """Return the brightness of the lit ground about each pixel (height, width).

    `window` is the side of the surroundings, a share of the width.
    """
    height, width = grey.shape
    small = cv2.resize(
        grey, (max(width // _COARSE, 1), max(height // _COARSE, 1)), interpolation=cv2.INTER_AREA
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


def _tones(ratio: NDArray[np.float32], gamma: float) -> NDArray[np.uint8]:
    scaled = cv2.convertScaleAbs(ratio, alpha=170.0)
    table = np.rint(255.0 * (np.arange(256) / 255.0) ** gamma).astype(np.uint8)
    return np.asarray(cv2.LUT(scaled, table))


def _threshold(ratio: NDArray[np.float32]) -> float | None:
    """Return the ratio below which a pixel is shadow, or None if the image shows none."""
    # A histogram does for both: the mode of lit ground, and the darkest pixels.
    bins: Any = cv2.calcHist([ratio], [0], None, [512], [0.0, 2.0]).ravel()
    level = (np.arange(512) + 0.5) / 256.0
    total = np.cumsum(bins)
    lit = float(level[np.searchsorted(total, 0.6 * total[-1])])
    above = float(level[min(np.searchsorted(total, 0.9 * total[-1]), 511)])
    # From the median of the lit upward there are no shadows: the spread of lit ground.
    spread = (above - lit) / 1.03
    core = float(level[np.searchsorted(total, min(_CORE, 0.2 * total[-1]))])
    if lit - core < max(_CONTRAST * spread, 1.0 - _DARKEST_LIT):
        return None
    return min(0.5 * (lit + core), _DARKEST_LIT)
