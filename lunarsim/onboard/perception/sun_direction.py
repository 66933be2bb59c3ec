"""Sun direction: its validity, and its effect on the length of shadows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.onboard.perception.shadow_model import MAX_SUN_ELEVATION, MIN_SUN_ELEVATION
from lunarsim.typing import Array

# Sun elevation at which the scatter between observations was determined, rad.
_REFERENCE_ELEVATION_RAD = float(np.deg2rad(20.0))
# Exponent of the shadow length ratio that scales the scatter; 1 pixel at 8 deg.
_SCATTER_POWER = 1.5


def unit_vector(sun: ArrayLike) -> Array:
    """Return the direction towards the Sun (3,) after checking its unit length.

    Raises
    ------
    InputError
        If it is not a unit vector.
    """
    direction = np.asarray(sun, dtype=np.float64)
    if direction.shape != (3,) or not abs(np.linalg.norm(direction) - 1.0) < 1e-6:
        raise InputError("sun", sun, "must be a unit vector (3,)")
    return direction


def has_usable_shadows(sun: Array) -> bool:
    """Return whether the Sun (3,) is between 2 and 80 deg high, as detection requires."""
    elevation = float(np.arcsin(np.clip(sun[2], -1.0, 1.0)))
    return bool(MIN_SUN_ELEVATION <= elevation <= MAX_SUN_ELEVATION)


def shadow_length_ratio(sun: Array) -> float:
    """Return the length of shadows relative to a Sun elevation of 20 deg, at least 1.

    `sun` (3,) is the direction towards the Sun.
    """
    ratio = np.tan(_REFERENCE_ELEVATION_RAD) * np.hypot(sun[0], sun[1]) / max(float(sun[2]), 1e-6)
    return max(float(ratio), 1.0)


def observation_scatter_factor(sun: Array) -> float:
    """Return the scatter of rock centres along the Sun relative to that at 20 deg.

    The scatter is that between observations of the same rock. `sun` (3,) is the direction towards
    the Sun; the result is at least 1.
    """
    return float(shadow_length_ratio(sun) ** _SCATTER_POWER)
