"""From what a site looks like on the quadtree to the probability that it is safe."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.safety.logistic import Logistic

Array = NDArray[np.float64]

# Fewer exceptions than one in so many points cannot be told from none.
_LEAST_RATIO = 1e-4
COUNT = 8


def features(slope: ArrayLike, roughness: ArrayLike, ratio: ArrayLike, near: ArrayLike) -> Array:
    """Return what the probability is computed from (n, 8).

    Parameters
    ----------
    slope, roughness
        Over the limits of the settings (n,): 1 at the limit.
    ratio, near
        Greatest exception ratio in the zone and in its middle (n,).
    """
    slope, roughness = (np.asarray(a, dtype=np.float64) for a in (slope, roughness))
    whole, middle = (
        np.log10(np.maximum(np.asarray(r, dtype=np.float64), _LEAST_RATIO) / _LEAST_RATIO)
        for r in (ratio, near)
    )
    rough = np.log(np.maximum(roughness, 1e-3))
    return np.column_stack(
        (np.ones(len(slope)), whole, middle, slope, rough, whole**2, middle**2, rough**2)
    )


@lru_cache(maxsize=1)
def measured() -> Logistic:
    """Return the regression measured by `scenarios/quadtree/calibration.py`."""
    return Logistic.packaged("lunarsim.onboard.hazards.quadtree", "calibration.json", COUNT)
