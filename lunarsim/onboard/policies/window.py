"""Field of view of the crew window; only visible sites can be designated.

The landing point designator of the Lunar Module was a scale on the commander's window. Its reading,
the look angle, is measured in the body frame from the forward direction downwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CrewWindow:
    """Look angles within which a site is visible and can be designated.

    Attributes
    ----------
    forward
        Azimuth of the window direction, from body x towards body y, rad.
    highest, lowest
        Look angles of the upper and lower edge, from forward downwards, rad.
    half_width
        Maximum angle of the line of sight out of the plane of forward and down, rad.
    """

    forward: float = quantity(
        0.0, "deg", ge=-180, le=180, help="Azimuth of the window from body x towards body y"
    )
    highest: float = quantity(
        -5.0, "deg", ge=-90, le=90, help="Look angle of the upper edge below forward"
    )
    lowest: float = quantity(
        65.0, "deg", ge=-90, le=90, help="Look angle of the lower edge below forward"
    )
    half_width: float = quantity(
        35.0, "deg", gt=0, le=90, help="Half width of the window to either side"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "window")
        if self.highest >= self.lowest:
            raise InputError(
                "window.highest", self.highest, f"must be less than lowest, {self.lowest:g}"
            )

    def angles(self, estimate: Estimate, sites: ArrayLike) -> tuple[Array, Array]:
        """Return look angle and angle to the left (...,), rad, of sites (..., 3), m."""
        line_of_sight = np.asarray(sites, dtype=np.float64) - estimate.position
        body = line_of_sight @ quat_to_matrix(estimate.attitude)
        c, s = np.cos(self.forward), np.sin(self.forward)
        ahead, left = c * body[..., 0] + s * body[..., 1], c * body[..., 1] - s * body[..., 0]
        look = np.arctan2(-body[..., 2], ahead)
        return look, np.arctan2(left, np.hypot(ahead, body[..., 2]))

    def sees(self, estimate: Estimate, sites: ArrayLike) -> NDArray[np.bool_]:
        """Return which sites (..., 3), local frame, m, are visible (...,)."""
        look, lateral = self.angles(estimate, sites)
        inside = (look >= self.highest) & (look <= self.lowest)
        return np.asarray(inside & (np.abs(lateral) <= self.half_width))
