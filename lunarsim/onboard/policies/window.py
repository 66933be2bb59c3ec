"""What can be seen through the lander's window: sites are redesignated only there.

The landing point designator of the lunar module was a scale on the commander's window; the angle on
it, the look angle, is counted from the vehicle's forward direction downwards in its own frame.
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
class Window:
    """Look angles within which a site can be seen and designated.

    Attributes
    ----------
    forward
        Direction of the window, from body x to body y, rad.
    highest, lowest
        Look angles between which the window opens, from forward downwards, rad.
    half_width
        Greatest angle of the line of sight out of the plane of forward and down, rad.
    """

    forward: float = quantity(0.0, "deg", ge=-180, le=180, help="of the window, from body x to y")
    highest: float = quantity(
        -5.0, "deg", ge=-90, le=90, help="look angle of its upper edge, below forward"
    )
    lowest: float = quantity(
        65.0, "deg", ge=-90, le=90, help="look angle of its lower edge, below forward"
    )
    half_width: float = quantity(35.0, "deg", gt=0, le=90, help="to either side")

    def __post_init__(self) -> None:
        check_bounds(self, "window")
        if self.highest >= self.lowest:
            raise InputError("window.highest", self.highest, f"less than {self.lowest}")

    def angles(self, estimate: Estimate, sites: ArrayLike) -> tuple[Array, Array]:
        """Return look angles and angles to the left (...,), rad, of sites (..., 3), local frame."""
        sight = np.asarray(sites, dtype=np.float64) - estimate.position
        body = sight @ quat_to_matrix(estimate.attitude)
        c, s = np.cos(self.forward), np.sin(self.forward)
        ahead, left = c * body[..., 0] + s * body[..., 1], c * body[..., 1] - s * body[..., 0]
        look = np.arctan2(-body[..., 2], ahead)
        return look, np.arctan2(left, np.hypot(ahead, body[..., 2]))

    def sees(self, estimate: Estimate, sites: ArrayLike) -> NDArray[np.bool_]:
        """Tell which sites (..., 3), local frame, can be seen (...,)."""
        look, aside = self.angles(estimate, sites)
        inside = (look >= self.highest) & (look <= self.lowest)
        return np.asarray(inside & (np.abs(aside) <= self.half_width))
