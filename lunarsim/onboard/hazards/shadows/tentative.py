"""What one image showed that is not tracked, and may be a rock if the next shows it too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TentativeRocks:
    """Detections of the last image that belong to no rock and are too vague to begin one.

    Attributes
    ----------
    xy
        Centres (n, 2), m.
    sigma
        Of the centres, the root of the mean variance of the two axes (n,), m.
    radius, radius_variance
        m (n,), m^2.
    existence
        Probability that each is a rock (n,).
    """

    xy: Array
    sigma: Array
    radius: Array
    radius_variance: Array
    existence: Array

    @classmethod
    def none(cls) -> TentativeRocks:
        """Return no detections."""
        empty = np.empty(0)
        return cls(np.empty((0, 2)), empty, empty, empty, empty)
