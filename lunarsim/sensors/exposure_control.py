"""Automatic exposure from the histogram of the last image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, check_types


@dataclass(frozen=True)
class ExposureControl:
    """Automatic exposure control from the histogram of the last image.

    The "bright end" of the histogram is a high percentile of the counts.

    Attributes
    ----------
    bright_end_target
        Target for the bright end of the histogram, as a fraction of full scale.
    bright_end_fraction
        Fraction of the pixels that are darker than the bright end; default 0.995.
    shortest, longest
        Limits of the exposure time, s.
    max_change_factor
        Maximum factor between consecutive exposure times.
    """

    bright_end_target: float = 0.8
    bright_end_fraction: float = 0.995
    shortest: float = 1e-5
    longest: float = 0.05
    max_change_factor: float = 8.0

    def __post_init__(self) -> None:
        check_types("camera.exposure_control", self)
        if not 0.0 < self.bright_end_target < 1.0:
            raise InputError(
                "camera.exposure_level", self.bright_end_target, "must be between 0 and 1"
            )
        if not 0.0 < self.bright_end_fraction < 1.0:
            raise InputError(
                "camera.bright_end_fraction", self.bright_end_fraction, "must be between 0 and 1"
            )
        if not 0.0 < self.shortest <= self.longest < np.inf:
            bounds = (self.shortest, self.longest)
            raise InputError(
                "camera.exposure_bounds",
                bounds,
                "must be two positive times, the shorter one first",
            )
        if not 1.0 < self.max_change_factor < np.inf:
            raise InputError(
                "camera.exposure_change", self.max_change_factor, "must be more than 1 and finite"
            )

    def next_exposure(
        self, counts: NDArray[np.unsignedinteger[Any]], bits: int, exposure: float
    ) -> float:
        """Return the exposure time (s) of the next image from the histogram of the last.

        If the bright end is saturated, the time is reduced by the maximum factor. A black image is
        followed by the maximum increase.

        Parameters
        ----------
        counts
            Counts of the last image (height, width).
        bits
            Bits of the converter.
        exposure
            Exposure time of the last image, s.
        """
        top = 2**bits - 1
        histogram = np.bincount(counts.ravel(), minlength=top + 1)
        bright = int(np.searchsorted(np.cumsum(histogram), self.bright_end_fraction * counts.size))
        factor = self.bright_end_target * top / max(bright, 0.5) if bright < top else 0.0
        factor = float(np.clip(factor, 1.0 / self.max_change_factor, self.max_change_factor))
        return float(np.clip(factor * exposure, self.shortest, self.longest))
