"""Rates of missed and false detections of shadows, by their size in pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsim.errors import InputError, check_types
from lunarsim.typing import Array

# Standard deviation of a uniform distribution over one pixel.
_PIXEL_SIGMA = 12.0**-0.5


@dataclass(frozen=True)
class DetectionRates:
    """Rates of missed and false detections, linear in q and limited at both ends.

    q is the square root of the number of dark pixels. A rate is clipped between its minimum and 1.
    The defaults are printed by `python scenarios/shadows/detection_rates.py`: rocks of all shapes
    on horizontal terrain, 5 % cover, Sun elevation 20 deg, blur 0.6 pixels. A test repeats the
    study.

    The paper defines q along the shadow (III.C). The square root of the area equals it for a
    square patch and also accounts for the part of a shadow that its rock hides.

    Attributes
    ----------
    missed
        False-negative rate: value at q = 0, slope, and minimum at large q.
    false
        Rate of detections that are not rocks: value at q = 0, slope, and minimum at large q.
    false_clear_line
        Rate at which an image declares the position of a rock free of rocks: value at q = 0, slope,
        and minimum at large q.
    blur
        Point spread of the camera for which the rates were determined, 1 sigma, pixels.
    """

    missed: tuple[float, float, float] = (1.428, -0.4175, 0.0422)
    false: tuple[float, float, float] = (1.172, -0.5177, 0.0088)
    false_clear_line: tuple[float, float, float] = (1.0, -0.3943, 0.0214)
    blur: float = 0.6

    def __post_init__(self) -> None:
        check_types("rates", self)
        for name in ("missed", "false", "false_clear_line"):
            _, slope, floor = getattr(self, name)
            if not slope <= 0.0:
                raise InputError(
                    f"rates.{name}[1]", slope, "must be 0 or less, because it is a slope"
                )
            if not 0.0 < floor < 1.0:
                raise InputError(f"rates.{name}[2]", floor, "must be more than 0 and less than 1")
        if not (np.isfinite(self.blur) and self.blur >= 0.0):
            raise InputError("rates.blur", self.blur, "must be 0 or more, and finite")

    def relative_edge_width(self, blur: float) -> float:
        """Return the width of image edges relative to that for these rates, at least 1.

        `blur` is the point spread of the camera, 1 sigma, pixels; the rates hold for the point
        spread `self.blur`. The size of a pixel adds to both. A wider edge fills shadows with light
        as larger pixels would.
        """
        return max(float(np.hypot(blur, _PIXEL_SIGMA) / np.hypot(self.blur, _PIXEL_SIGMA)), 1.0)

    def false_negative(self, q: Any) -> Array:
        """Return the false-negative rate FN(q) of shadows (...).

        `q` (...) is the square root of the number of dark pixels.
        """
        return _clipped_line(self.missed, q)

    def false_positive(self, q: Any) -> Array:
        """Return the false-positive rate FP(q) of detections (...).

        `q` (...) is the square root of the number of dark pixels.
        """
        return _clipped_line(self.false, q)

    def false_clear(self, q: Any) -> Array:
        """Return the rate at which an image wrongly shows a rock's position as free (...).

        `q` is the square root of the number of dark pixels of the rock.
        """
        return _clipped_line(self.false_clear_line, q)

    @property
    def min_q(self) -> float:
        """Value of q below which every shadow is missed; the paper calls it resolution."""
        start, slope, _ = self.missed
        return max((1.0 - start) / slope, 0.0) if slope < 0.0 else 0.0


def _clipped_line(line: tuple[float, float, float], q: Any) -> Array:
    """Return the rate of a line, limited to a minimum and to 1, at q (...).

    `line` is the value at q = 0, the slope, and the minimum at large q.
    """
    start, slope, floor = line
    return np.clip(start + slope * np.asarray(q, dtype=np.float64), floor, 1.0)
