"""The Sun, and how the ground reflects its light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import direction_from_angles
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Light:
    """The Sun and how the ground reflects it.

    Attributes
    ----------
    azimuth, elevation
        Of the Sun, rad; below the horizon nothing but `ambient` is left.
    albedo
        Normal albedo; 0.12 is a bright mare.
    ambient
        Radiance factor of a shadowed surface over its albedo: Earthshine and scattered light. Full
        Earthshine is about 1e-4.
    photometry
        "lambert" or "lunar-lambert" (McEwen 1991).
    """

    azimuth: float = quantity(270.0, "deg", help="of the Sun, clockwise from north")
    elevation: float = quantity(20.0, "deg", ge=-90, le=90, help="of the Sun above the horizon")
    albedo: float = quantity(0.12, gt=0, le=1, help="normal albedo")
    ambient: float = quantity(0.0, ge=0, le=1, help="I/F of shadows over the albedo")
    photometry: Literal["lambert", "lunar-lambert"] = quantity(
        "lunar-lambert", help="how the ground reflects"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "sun")
        if self.photometry not in {"lambert", "lunar-lambert"}:
            raise InputError("sun.photometry", self.photometry, "lambert or lunar-lambert")

    @property
    def direction(self) -> Array:
        """Unit vector towards the Sun (3,), ENU."""
        return direction_from_angles(self.azimuth, self.elevation)
