"""Detections of one image that may be rocks if the next image confirms them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.typing import Array


@dataclass(frozen=True)
class TentativeRocks:
    """Detections of the last image that are not tracked but may be rocks.

    They are too inaccurate to start a track.

    Attributes
    ----------
    xy
        Centres (n, 2), m.
    sigma
        Position error, root of the mean variance of both axes (n,), m.
    radius, radius_variance
        Radius (n,), m, and its variance, m^2.
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
        """Return an object without any detection."""
        empty = np.empty(0)
        return cls(np.empty((0, 2)), empty, empty, empty, empty)
