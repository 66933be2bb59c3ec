"""Effect of an unobserved rock on a lander, and the area in which it matters."""

from __future__ import annotations

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.typing import Array

# Height of the triangle of pads over their radius: between the values for three and four legs.
_TRIANGLE_HEIGHT_RATIO = 1.4
# Margin around a pad within which the centre of a rock may lie under it, m.
_ROCK_MARGIN_M = 0.2


def footprint_area(lander: Lander) -> float:
    """Return the area inside the circle through the pads of a lander, m^2."""
    return float(np.pi * lander.leg_radius**2)


def pad_ring_area(lander: Lander) -> float:
    """Return the area of the ring that the pads may touch at any heading, m^2."""
    return float(2.0 * np.pi * lander.leg_radius * (lander.pad_diameter + _ROCK_MARGIN_M))


def tilt_limit_rock_height(slope: Array, lander: Lander) -> Array:
    """Return the rock height under a pad that tilts a lander to its limit (...), m.

    The result is 0 or less where the terrain slope alone reaches the limit.

    Parameters
    ----------
    slope
        Tangent of the terrain slope over the tangent of the slope limit (...).
    lander
        Geometry and limits.
    """
    return np.asarray(
        (1.0 - slope) * np.tan(lander.slope_limit) * _TRIANGLE_HEIGHT_RATIO * lander.leg_radius
    )


def min_tilt_limit_rock_height(slope: Array, lander: Lander) -> Array:
    """Return the minimum rock height under a pad that tilts a lander to its limit, m.

    The minimum is over headings. `slope` (...) is the tangent of the terrain slope over the tangent
    of the slope limit. The result (...) is 0 or less where the terrain slope reaches the limit.

    One pad of four tilts the lander about the line through its neighbours and the centre; one pad
    of three tilts it about the line through the other two.
    """
    span = 1.0 if lander.legs == 4 else 1.5
    return np.asarray((1.0 - slope) * np.tan(lander.slope_limit) * span * lander.leg_radius)


def tilt_tangent(height: Array, lander: Lander) -> Array:
    """Return the tangent of a lander's tilt on flat terrain with one pad raised (...).

    `height` (...) is how far the pad is raised, m.
    """
    return np.asarray(height / (_TRIANGLE_HEIGHT_RATIO * lander.leg_radius))
