"""Automatic exposure: the next picture's time from the last one's histogram."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, check_types


@dataclass(frozen=True)
class ExposureControl:
    """What an automatic exposure aims at.

    Attributes
    ----------
    level
        Where the bright end of the histogram shall come to lie, over full scale.
    share
        Share of the pixels that shall be darker than that.
    shortest, longest
        Bounds of the time, s.
    most_change
        Greatest factor from one picture to the next.
    """

    level: float = 0.8
    share: float = 0.995
    shortest: float = 1e-5
    longest: float = 0.05
    most_change: float = 8.0

    def __post_init__(self) -> None:
        check_types("camera.exposure_control", self)
        if not 0.0 < self.level < 1.0:
            raise InputError("camera.exposure_level", self.level, "between 0 and 1")
        if not 0.0 < self.share < 1.0:
            raise InputError("camera.exposure_share", self.share, "between 0 and 1")
        if not 0.0 < self.shortest <= self.longest < np.inf:
            bounds = (self.shortest, self.longest)
            raise InputError("camera.exposure_bounds", bounds, "two positive times, shortest first")
        if not 1.0 < self.most_change < np.inf:
            raise InputError("camera.exposure_change", self.most_change, "a factor above 1")

    def after(self, counts: NDArray[np.unsignedinteger[Any]], bits: int, exposure: float) -> float:
        """Return the time (s) for the next picture.

        A picture whose bright end is clipped says only that it was too long: the time falls by the
        greatest factor. A black one is followed by the longest step up.

        Parameters
        ----------
        counts
            The last picture (height, width).
        bits
            Of its converter.
        exposure
            Its time, s.
        """
        top = 2**bits - 1
        histogram = np.bincount(counts.ravel(), minlength=top + 1)
        bright = int(np.searchsorted(np.cumsum(histogram), self.share * counts.size))
        factor = self.level * top / max(bright, 0.5) if bright < top else 0.0
        factor = float(np.clip(factor, 1.0 / self.most_change, self.most_change))
        return float(np.clip(factor * exposure, self.shortest, self.longest))
