"""What a rock that no sample has met would do to a lander, and on how much ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.lander import Lander

Array = NDArray[np.float64]

# Height of the triangle of the pads over their radius: between those of three legs and of four.
_SPAN = 1.4
# Width about a pad in which a rock's middle may lie under it, m.
_ROCK = 0.2


def footprint_area(lander: Lander) -> float:
    """Return the area within the circle of the pads, m^2."""
    return float(np.pi * lander.leg_radius**2)


def pad_ring_area(lander: Lander) -> float:
    """Return the area that the pads may stand on at any heading, m^2."""
    return float(2.0 * np.pi * lander.leg_radius * (lander.pad_diameter + _ROCK))


def tilting_height(slope: Array, lander: Lander) -> Array:
    """Return how high a rock under a pad takes up what is left of the slope (...), m.

    Parameters
    ----------
    slope
        Tangent over that of the limit (...).
    lander
        Geometry and limits.
    """
    return np.asarray((1.0 - slope) * np.tan(lander.slope_limit) * _SPAN * lander.leg_radius)


def least_tilting_height(slope: Array, lander: Lander) -> Array:
    """Return the least height that does so at some heading (...), m; as `tilting_height`.

    A pad of four turns the lander about the line of its neighbours, through the middle; a pad of
    three about the line of the other two.
    """
    span = 1.0 if lander.legs == 4 else 1.5
    return np.asarray((1.0 - slope) * np.tan(lander.slope_limit) * span * lander.leg_radius)


def tilt_of(height: Array, lander: Lander) -> Array:
    """Return the tangent of the tilt (...) of a lander on level ground, a pad raised (...), m."""
    return np.asarray(height / (_SPAN * lander.leg_radius))
