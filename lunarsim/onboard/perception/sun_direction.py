"""What follows from the direction towards the Sun: whether there are shadows, and how long."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.perception.shadow_model import LEAST_ELEVATION, MOST_ELEVATION

Array = NDArray[np.float64]

# Elevation of the Sun at which what looks differ by was found, rad.
_REFERENCE_ELEVATION_RAD = float(np.deg2rad(20.0))
# They differ by this power of how much longer shadows are under a lower one: by 1 pixel at 8 deg.
_SCATTER_POWER = 1.5


def unit_vector(sun: ArrayLike) -> Array:
    """Return the direction towards the Sun (3,).

    Raises
    ------
    InputError
        If it is no unit vector.
    """
    direction = np.asarray(sun, dtype=np.float64)
    if direction.shape != (3,) or not abs(np.linalg.norm(direction) - 1.0) < 1e-6:
        raise InputError("sun", sun, "a unit vector (3,), ENU")
    return direction


def has_usable_shadows(sun: Array) -> bool:
    """Tell whether the Sun (3,) stands where rocks are seen by their shadows: 2 to 80 deg high."""
    elevation = float(np.arcsin(np.clip(sun[2], -1.0, 1.0)))
    return bool(LEAST_ELEVATION <= elevation <= MOST_ELEVATION)


def shadow_length_ratio(sun: Array) -> float:
    """Return how much longer shadows are under a low Sun (3,) than under 20 deg; 1 for others."""
    ratio = np.tan(_REFERENCE_ELEVATION_RAD) * np.hypot(sun[0], sun[1]) / max(float(sun[2]), 1e-6)
    return max(float(ratio), 1.0)


def observation_scatter_factor(sun: Array) -> float:
    """Return how much more centres differ from look to look along a low Sun (3,); 1 for others."""
    return float(shadow_length_ratio(sun) ** _SCATTER_POWER)
