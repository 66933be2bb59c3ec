"""Measure the sharpness of shadow edges to detect defocus and motion blur."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.onboard.perception import _image_quality_kernels as kernels
from lunarsim.onboard.perception.detector import Detections

# Minimum brightness step of an edge relative to lit terrain, and as a multiple of the noise,
# because noise alone can make edges of single pixels.
_MIN_STEP, _MIN_STEP_SIGMAS = 0.4, 15.0
# Maximum slope of a Gaussian edge of width 1.
_UNIT_EDGE_SLOPE = 1.0 / np.sqrt(2.0 * np.pi)
# Variance added to that of an edge by a difference over two pixels and by the pixel size.
_DIFFERENCE_VARIANCE = 4.0 / 12.0
# A difference over two pixels cannot exceed the range, so no width below this can be measured,
# pixels.
MIN_WIDTH = 2.0 * _UNIT_EDGE_SLOPE
# Fraction of the shadows that are taken to be as sharp as the optics permit. Others have round
# rocks or penumbrae at their edges.
_SHARPEST_FRACTION = 0.2
# Maximum number of shadows evaluated.
_MAX_SHADOWS = 150


@dataclass(frozen=True)
class EdgeWidths:
    """Widths of the shadow edges in an image, 1 sigma, pixels.

    They are measured from brightness differences over two pixels.

    Attributes
    ----------
    number
        Number of shadows with measured edges.
    sharpest
        Width across the edge, where brightness changes most: 20 % quantile over the shadows;
        infinite without a shadow.
    least_sharp_direction
        20 % quantile of the widths along each of four image directions, maximum over these
        directions. It exceeds `sharpest` under motion blur.
    """

    number: int
    sharpest: float
    least_sharp_direction: float

    @staticmethod
    def expected(blur_sigma: float) -> float:
        """Return the edge width expected for a point spread (1 sigma, pixels)."""
        return float(np.sqrt(blur_sigma**2 + _DIFFERENCE_VARIANCE))


def edge_widths(detections: Detections, noise: float) -> EdgeWidths:
    """Measure the widths of rock shadow edges, to detect defocus and motion blur.

    An edge blurred by a Gaussian point spread of width s has a maximum slope of 0.4 / s times its
    height. The height is the brightness range within three pixels. For the slope along a direction
    it is the range along that direction, because the range around a lit face belongs to another
    edge.

    Parameters
    ----------
    detections
        Rocks detected in the image.
    noise
        Noise of a pixel relative to the brightness of lit terrain.
    """
    min_step = max(_MIN_STEP, _MIN_STEP_SIGMAS * noise)
    # Labels are sorted by image row, so every n-th samples the image evenly.
    stride = -(-len(detections) // _MAX_SHADOWS) or 1
    slopes = kernels.edge_slopes(
        detections.relative_to_lit_terrain, detections.rock, len(detections), stride, min_step
    )[1:]
    slopes = slopes[slopes[:, -1] > 0.0]
    if len(slopes) == 0:
        return EdgeWidths(0, np.inf, np.inf)
    with np.errstate(divide="ignore"):
        each = _UNIT_EDGE_SLOPE / slopes
    widths = np.quantile(each, _SHARPEST_FRACTION, axis=0, method="lower")
    return EdgeWidths(len(each), float(widths[-1]), float(widths[:-1].max()))
