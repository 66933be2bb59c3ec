"""Draw text, bars and projected polygons on RGB images."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.models.pinhole import View
from lunarsim.typing import Array

Image = NDArray[np.uint8]

BACKGROUND, TEXT, BAR, BAR_BACKGROUND = (6, 6, 10), (235, 235, 235), (86, 180, 233), (70, 74, 84)
# Largest pixel coordinate that is passed to OpenCV.
_MAX_PIXEL = 4e3
_MIN_DEPTH_M = 0.1


def draw_text(image: Image, text: str, at: tuple[int, int], scale: float = 0.42) -> None:
    """Draw a line of text with a dark edge; `at` is its lower left corner, pixels."""
    for colour, width in ((BACKGROUND, 3), (TEXT, 1)):
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, width, cv2.LINE_AA)


def project(view: View, points: Array) -> NDArray[np.int32] | None:
    """Project points (n, 3) to pixels (n, 2); None if a point is behind the camera."""
    seen = (np.asarray(points) - view.position) @ view.axes
    if (seen[:, 2] < _MIN_DEPTH_M).any():
        return None
    flat = seen[:, :2] / seen[:, 2:] * (view.fx, view.fy) + (view.cx, view.cy)
    return np.round(np.clip(flat, -_MAX_PIXEL, _MAX_PIXEL)).astype(np.int32)


def fill_polygon(image: Image, view: View, points: Array, colour: tuple[int, ...]) -> None:
    """Fill a polygon (n, 3) in ENU, m, unless a corner is behind the camera."""
    flat = project(view, points)
    if flat is not None:
        cv2.fillPoly(image, [flat], colour, cv2.LINE_AA)


def draw_gauges(
    rows: Sequence[tuple[str, str, float | None]], width: int, height: int, value_column: int = 112
) -> Image:
    """Return an RGB image (height, width, 3) of names, values and bars.

    Parameters
    ----------
    rows
        Name, value and length of the bar of each gauge; the length is in [0, 1], None: no bar.
    width, height
        Size of the image, pixels.
    value_column
        Column at which values begin, pixels.
    """
    image = np.full((height, width, 3), BACKGROUND, np.uint8)
    for i, (name, value, share) in enumerate(rows):
        top = 16 + 19 * i
        draw_text(image, name, (8, top))
        draw_text(image, value, (value_column, top))
        if share is not None:
            full = round((width - 16) * min(max(float(share), 0.0), 1.0))
            ends = (8, top + 4), (width - 8, top + 6)
            cv2.rectangle(image, *ends, BAR_BACKGROUND, -1)
            cv2.rectangle(image, ends[0], (8 + full, top + 6), BAR, -1)
    return image
