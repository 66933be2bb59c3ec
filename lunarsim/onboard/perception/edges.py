"""How sharp the edges of shadows are: whether a picture is in focus and still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.perception import _health_kernels as kernels
from lunarsim.onboard.perception.detector import Detections

Array = NDArray[np.float64]

# Brightness, over that of lit ground, by which the sides of an edge must differ, and as a multiple
# of the noise, of which alone single pixels are edges.
_MIN_STEP, _MIN_STEP_SIGMAS = 0.4, 15.0
# A normal edge of width 1 is as steep as this.
_UNIT_EDGE_SLOPE = 1.0 / np.sqrt(2.0 * np.pi)
# A difference over two pixels adds this to the square of a width, and a pixel's own size a quarter
# of it.
_DIFFERENCE_VARIANCE = 4.0 / 12.0
# No difference over two pixels exceeds the range it is compared with: what is sharper shows no
# sharper, pixels.
MIN_WIDTH = 2.0 * _UNIT_EDGE_SLOPE
# Share of the shadows that are taken to be as sharp as the optics let them be: others have round
# rocks or half-shade at their edges.
_SHARPEST_FRACTION = 0.2
# As many shadows tell.
_MAX_SHADOWS = 150


@dataclass(frozen=True)
class EdgeWidths:
    """Widths of the edges of shadows, 1 sigma, pixels, as differences over two pixels show them.

    Attributes
    ----------
    number
        Of shadows whose edges were measured.
    sharpest
        Of the sharpest fifth of them, along the steepest slope; infinite for none.
    least_sharp
        The same along one direction, that in which it is greatest.
    """

    number: int
    sharpest: float
    least_sharp: float

    @staticmethod
    def expected(blur_sigma: float) -> float:
        """Return the width of a step seen through a point spread (1 sigma, pixels)."""
        return float(np.sqrt(blur_sigma**2 + _DIFFERENCE_VARIANCE))


def edge_widths(seen: Detections, noise: float) -> EdgeWidths:
    """Measure the edges of rocks' shadows.

    An edge that optics blur with a normal point spread of width s is at its steepest 0.4 / s of its
    height; the height is taken from the range of brightness within three pixels, and for the slope
    along a direction from that along it: beside a lit face, the range all about is the height of
    another edge.

    Parameters
    ----------
    seen
        Rocks found in the picture.
    noise
        Of a pixel over the brightness of lit ground.
    """
    min_step = max(_MIN_STEP, _MIN_STEP_SIGMAS * noise)
    # Labels run down the picture: every so many of them lie evenly over all of it.
    every = -(-len(seen) // _MAX_SHADOWS) or 1
    slopes = kernels.edge_slopes(seen.over_ground, seen.rock, len(seen), every, min_step)[1:]
    slopes = slopes[slopes[:, -1] > 0.0]
    if len(slopes) == 0:
        return EdgeWidths(0, np.inf, np.inf)
    with np.errstate(divide="ignore"):
        each = _UNIT_EDGE_SLOPE / slopes
    widths = np.quantile(each, _SHARPEST_FRACTION, axis=0, method="lower")
    return EdgeWidths(len(each), float(widths[-1]), float(widths[:-1].max()))
