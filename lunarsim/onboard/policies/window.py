"""Field of view of the crew window; only visible sites can be designated.

The landing point designator of the Lunar Module was a scale on the commander's window. Its reading,
the look angle, is measured in the body frame from the forward direction downwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array, BoolArray


@dataclass(frozen=True)
class CrewWindow:
    """Field of view of the crew window; only sites inside can be designated.

    Attributes
    ----------
    azimuth
        Azimuth of the window direction, from body x towards body y, rad.
    upper_edge, lower_edge
        Look angles of the upper and lower edge, from forward downwards, rad.
    half_width
        Maximum angle of the line of sight out of the plane of forward and down, rad.
    """

    azimuth: float = quantity(
        0.0,
        "deg",
        ge=-180,
        le=180,
        help="Direction of the window: angle from body x towards body y",
    )
    upper_edge: float = quantity(
        -5.0,
        "deg",
        ge=-90,
        le=90,
        help="Angle of the window's upper edge below the forward direction; negative: above it",
    )
    lower_edge: float = quantity(
        65.0,
        "deg",
        ge=-90,
        le=90,
        help="Angle of the window's lower edge below the forward direction",
    )
    half_width: float = quantity(
        35.0,
        "deg",
        gt=0,
        le=90,
        help="Horizontal angle from the middle of the window to its left or right edge",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "window")
        if self.upper_edge >= self.lower_edge:
            raise InputError(
                "window.upper_edge_deg",
                round(float(np.rad2deg(self.upper_edge)), 6),
                f"must be less than lower_edge_deg, which is {np.rad2deg(self.lower_edge):g} deg",
            )

    def angles(self, estimate: Estimate, sites: ArrayLike) -> tuple[Array, Array]:
        """Return vertical and lateral viewing angles of sites (..., 3), m, in the window.

        Sites are in the local frame. The first angle is the look angle, from forward downwards; the
        second is the angle to the left of the vertical plane. Both are (...,), rad.
        """
        line_of_sight = np.asarray(sites, dtype=np.float64) - estimate.position
        body = line_of_sight @ quat_to_matrix(estimate.attitude)
        c, s = np.cos(self.azimuth), np.sin(self.azimuth)
        ahead, left = c * body[..., 0] + s * body[..., 1], c * body[..., 1] - s * body[..., 0]
        look = np.arctan2(-body[..., 2], ahead)
        return look, np.arctan2(left, np.hypot(ahead, body[..., 2]))

    def is_visible(self, estimate: Estimate, sites: ArrayLike) -> BoolArray:
        """Return which sites (..., 3), local frame, m, are visible in the window (...,)."""
        look, lateral = self.angles(estimate, sites)
        inside = (look >= self.upper_edge) & (look <= self.lower_edge)
        return np.asarray(inside & (np.abs(lateral) <= self.half_width))
