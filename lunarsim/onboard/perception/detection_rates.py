"""How often a shadow of q pixels is missed, and how often one that is seen is no rock's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, check_types

Array = NDArray[np.float64]

# Point spread of a pixel, 1 sigma, pixels.
_PIXEL_SIGMA = 12.0**-0.5


@dataclass(frozen=True)
class DetectionRates:
    """Rates linear in q, the root of the number of dark pixels, cut at both ends.

    The defaults are the lines that `python scenarios/shadows/rates.py` prints: rocks of all shapes
    on level ground, 5 % cover, the Sun 20 deg high, a blur of 0.6 pixels. A test repeats it.

    The paper takes q along the shadow (III.C); the root of the area equals it for a square patch
    and also tells what is left of a shadow that its rock hides.

    Attributes
    ----------
    missed
        False-negative rate at q = 0 and its slope; least rate at large q.
    false
        The same for detections that are no rock's.
    cleared
        The same for rocks where a picture gives the ground as free of them.
    blur
        Point spread of the camera that they are measured with, 1 sigma, pixels.
    """

    missed: tuple[float, float, float] = (1.428, -0.4175, 0.0422)
    false: tuple[float, float, float] = (1.172, -0.5177, 0.0088)
    cleared: tuple[float, float, float] = (1.0, -0.3943, 0.0214)
    blur: float = 0.6

    def __post_init__(self) -> None:
        check_types("rates", self)
        for name in ("missed", "false", "cleared"):
            _, slope, floor = getattr(self, name)
            if not (slope <= 0.0 and 0.0 < floor < 1.0):
                raise InputError(
                    f"rates.{name}", getattr(self, name), "a slope up to 0, a floor from 0 to 1"
                )

        if not (np.isfinite(self.blur) and self.blur >= 0.0):
            raise InputError("rates.blur", self.blur, "0 or a positive number, pixels")

    def wider(self, blur: float) -> float:
        """Return by what factor a camera spreads edges wider than the rates know them; at least 1.

        A pixel spreads them too. Shadows are filled with light as pixels larger by that would.
        """
        return max(float(np.hypot(blur, _PIXEL_SIGMA) / np.hypot(self.blur, _PIXEL_SIGMA)), 1.0)

    def false_negative(self, q: Any) -> Array:
        """Return FN(q) (...)."""
        return _clipped_line(self.missed, q)

    def false_positive(self, q: Any) -> Array:
        """Return FP(q) (...)."""
        return _clipped_line(self.false, q)

    def false_clear(self, q: Any) -> Array:
        """Return the rate at which the place of a rock of q pixels is given as free (...)."""
        return _clipped_line(self.cleared, q)

    @property
    def least_q(self) -> float:
        """The q below which every shadow is missed: what the paper calls the resolution."""
        start, slope, _ = self.missed
        return max((1.0 - start) / slope, 0.0) if slope < 0.0 else 0.0


def _clipped_line(line: tuple[float, float, float], q: Any) -> Array:
    start, slope, floor = line
    return np.clip(start + slope * np.asarray(q, dtype=np.float64), floor, 1.0)
